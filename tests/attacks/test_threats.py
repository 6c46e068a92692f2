"""Threats by name, and what imperfect tracking costs."""

import json

import numpy as np
import pytest

from spoofgym.attacks import ATTACKS, THREATS, AttackContext, make_attack
from spoofgym.core.registry import build_spec
from spoofgym.detectors import Never
from spoofgym.receiver import TightlyCoupled
from spoofgym.receiver.kalman import normalized_innovation_squared
from spoofgym.receiver.matching import Motion, matched_sensors
from spoofgym.simulation import TightlyCoupledSetup, Timeline
from spoofgym.simulation.simulator import run_serially
from spoofgym.truth.scenario import Scenario, make_scenario

from ..envs.support import single

REFERENCE = {
    (1.0, 5.0): (28.0, 853.0),
    (5.0, 30.0): (18.0, 385.0),
    (1.0, 30.0): (0.8, 15.0),
    (0.1, 5.0): (0.3, 8.0),
}
"""Added NIS per epoch in the linear surrogate, `trolley` and `groves`, by SD and correlation."""
RUNS = 32


@pytest.mark.parametrize("name", THREATS)
def test_a_threat_is_a_spec_that_fits_into_json_and_names_itself(name):
    assert json.loads(json.dumps(THREATS[name])) == THREATS[name]
    attack = make_attack(name)
    assert attack.label == name
    again = make_attack(json.loads(json.dumps(build_spec("attack", ATTACKS, attack))))
    assert again.label == name
    assert {**vars(again)} == {**vars(attack)}


def test_messages_list_attacks_and_threats_once() -> None:
    names = sorted({*ATTACKS, *THREATS})
    with pytest.raises(ValueError, match=rf"unknown attack 'mecaoner'; valid: {', '.join(names)};"):
        make_attack("mecaoner")
    with pytest.raises(TypeError, match=rf"^an attack is a name \({', '.join(names)}\), a dict"):
        make_attack(3)


def test_changed_settings_of_a_threat_stand_in_its_label():
    attack = make_attack({"name": "tracking-1m", "rate_limit_mps": 2.0})
    assert (attack.rate_limit_mps, attack.tracking.sd_m) == (2.0, 1.0)
    assert attack.label == "tracking-1m rate_limit_mps=2.0"
    assert "pseudorange-only" in make_attack({"name": "tracking-1m", "coherent": False}).label


def test_an_unknown_threat_is_told_the_near_one():
    with pytest.raises(ValueError, match=r"valid: false-position, .*did you mean 'tracking-1m'"):
        make_attack("tracking-2m")


def test_a_threat_is_taken_where_an_attack_is():
    env = single(attack="meaconer", scenario="trolley", receiver="matched")
    assert env.action_space.shape == (1,)
    assert env.unwrapped.core.setup.attack.label == "meaconer"
    assert env.unwrapped.core.setup.receiver.tuning == "matched"
    env.close()
    with pytest.raises(ValueError, match=r"unknown receiver 'match'; .*did you mean 'matched'"):
        single(receiver="match")


def test_a_partial_constellation_is_one_of_two():
    attack = make_attack("partial-constellation")
    world = make_scenario("trolley-two-constellations").world()
    taken = [
        s for s, yes in zip(world.satellite_ids, attack.select_channels(world), strict=True) if yes
    ]
    others = [s for s in world.satellite_ids if s and s not in taken]
    assert all(s.startswith("E") for s in taken)
    assert all(s.startswith("S") for s in others)
    assert min(len(taken), len(others)) >= 4
    with pytest.raises(ValueError, match=r"satellite 'E\*' is not in view on 'zhong2025'"):
        attack.bind(AttackContext(1, Scenario().world()))


def added_nis(errors, tracking, inertial=None):
    """NIS that a tracking error adds per epoch, against the clean run of the same noise."""
    attack = make_attack({"name": "false-position", "tracking": tracking})
    phases = Timeline(warmup_s=200.0, live_s=0.0, attack_s=150.0, time_to_alert_s=0.0)
    receiver = TightlyCoupled(tuning="matched")
    setup = TightlyCoupledSetup(
        scenario=Scenario(errors=errors),
        receiver=receiver,
        attack=attack,
        detector=Never(),
        timeline=phases,
    )
    setup.fields = setup.has
    if inertial is not None:
        noise = setup.combinations[0].noise._replace(inertial=inertial)
        setup.combinations._all[0] = setup.combinations[0]._replace(
            noise_psd=receiver.noise_psd(noise), covariance=receiver.initial_covariance(noise)
        )
    clean, attacked = (setup.simulator(RUNS, run_serially) for _ in range(2))
    for simulator in (clean, attacked):
        simulator.start_episodes([np.random.default_rng([5, run]) for run in range(RUNS)])
        simulator.run_filter_only(setup.onset)
    total = 0.0
    for _ in range(setup.steps):
        without = clean.advance().innovation.copy()
        epoch = attacked.predict(None)
        change = epoch.innovation - without
        total += normalized_innovation_squared(
            change, epoch.innovation_cov, 0, change.shape[1]
        ).mean()
        clean.update(None)
        attacked.update(None)
    return total / setup.steps


@pytest.mark.parametrize("number", [0, 1], ids=["trolley", "groves"])
@pytest.mark.parametrize("case", REFERENCE, ids=str)
def test_a_tracking_error_costs_what_the_reference_says(case, number):
    """Pseudorange noise of the matched receiver, inertial sensors as their data sheet says."""
    tracking = dict(zip(("sd_m", "correlation_s"), case, strict=True))
    sheet = matched_sensors("aviation", Motion())
    found = added_nis(("trolley", "groves")[number], tracking, sheet)
    assert found == pytest.approx(REFERENCE[case][number], rel=0.2)


def test_a_receiver_that_expects_manoeuvres_takes_slow_errors_for_motion():
    tracking = {"sd_m": 1.0, "correlation_s": 30.0}
    sheet = added_nis("groves", tracking, matched_sensors("aviation", Motion()))
    assert added_nis("groves", tracking) < 0.75 * sheet
