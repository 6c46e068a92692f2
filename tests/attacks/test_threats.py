"""Threats by name, and what imperfect tracking costs."""

import json
from functools import cache

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
from tests.nightly import heavy

RUNS = 32
NAMES = sorted({*ATTACKS, *THREATS})
REFERENCE = [
    ("trolley", 1.0, 5.0, 28.0),
    ("trolley", 5.0, 30.0, 18.0),
    ("trolley", 1.0, 30.0, 0.8),
    ("trolley", 0.1, 5.0, 0.3),
    ("groves", 1.0, 5.0, 853.0),
    ("groves", 5.0, 30.0, 385.0),
    ("groves", 1.0, 30.0, 15.0),
    ("groves", 0.1, 5.0, 8.0),
]
"""Added NIS per epoch in the linear surrogate, by errors, SD and correlation of the tracking."""


@pytest.mark.parametrize("name", THREATS)
def test_a_threat_is_a_spec_that_fits_into_json_and_names_itself(name):
    assert json.loads(json.dumps(THREATS[name])) == THREATS[name]
    attack = make_attack(name)
    again = make_attack(json.loads(json.dumps(build_spec("attack", ATTACKS, attack))))
    assert again.label == attack.label == name
    assert vars(again) == vars(attack)


def test_changed_settings_of_a_threat_stand_in_its_label():
    attack = make_attack({"name": "tracking-1m", "rate_limit_mps": 2.0})
    assert (attack.rate_limit_mps, attack.tracking.sd_m) == (2.0, 1.0)
    assert attack.label == "tracking-1m rate_limit_mps=2.0"
    assert "pseudorange-only" in make_attack({"name": "tracking-1m", "coherent": False}).label


@pytest.mark.parametrize(
    ("attack", "said"),
    [
        ("mecaoner", rf"unknown attack 'mecaoner'; valid: {', '.join(NAMES)};"),
        ("tracking-2m", r"valid: false-position, .*did you mean 'tracking-1m'"),
        (3, rf"^an attack is a name \({', '.join(NAMES)}\), a dict"),
    ],
)
def test_messages_list_attacks_and_threats_once(attack, said):
    with pytest.raises((ValueError, TypeError), match=said):
        make_attack(attack)


def test_a_partial_constellation_is_one_of_two():
    attack = make_attack("partial-constellation")
    world = make_scenario("trolley-two-constellations").world()
    ids = np.array(world.satellite_ids)
    taken = attack.select_channels(world)
    kinds = [{name[0] for name in ids[which] if name} for which in (taken, ~taken)]
    assert kinds == [{"E"}, {"S"}]
    assert min(taken.sum(), (ids[~taken] != "").sum()) >= 4
    with pytest.raises(ValueError, match=r"satellite 'E\*' is not in view on 'zhong2025'"):
        attack.bind(AttackContext(1, Scenario().world()))


@cache
def added_nis(errors, sd_m, correlation_s, by_data_sheet=True):
    """NIS that a tracking error adds per epoch, against the clean run of the same noise."""
    tracking = {"sd_m": sd_m, "correlation_s": correlation_s}
    receiver = TightlyCoupled(tuning="matched")
    setup = TightlyCoupledSetup(
        scenario=Scenario(errors=errors),
        receiver=receiver,
        attack={"name": "false-position", "tracking": tracking},
        detector=Never(),
        timeline=Timeline(warmup_s=200.0, live_s=0.0, attack_s=150.0, time_to_alert_s=0.0),
    )
    setup.fields = setup.has
    if by_data_sheet:
        inertial = matched_sensors("aviation", Motion())
        noise = setup.combinations[0].noise._replace(inertial=inertial)
        setup.combinations._made[0] = setup.combinations[0]._replace(
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
        S, rows = epoch.innovation_cov, change.shape[1]
        total += normalized_innovation_squared(change, S, 0, rows).mean()
        clean.update(None)
        attacked.update(None)
    return total / setup.steps


@pytest.mark.parametrize("case", heavy(REFERENCE, *REFERENCE[:6], REFERENCE[7]), ids=str)
def test_a_tracking_error_costs_what_the_reference_says(case):
    """Pseudorange noise of the matched receiver, inertial sensors as their data sheet says."""
    *settings, wanted = case
    assert added_nis(*settings) == pytest.approx(wanted, rel=0.2)


def test_a_receiver_that_expects_manoeuvres_takes_slow_errors_for_motion():
    assert added_nis("groves", 1.0, 30.0, False) < 0.75 * added_nis("groves", 1.0, 30.0)
