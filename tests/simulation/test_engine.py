"""What must be the same to the last bit, on one machine."""

import numpy as np
import pytest

from spoofgym.detectors import Never
from spoofgym.receiver import TightlyCoupled, replay
from spoofgym.simulation import Engine, LooselyCoupledSetup, TightlyCoupledSetup, WheeledRobotSetup
from spoofgym.simulation._kernels import NO_FORM
from spoofgym.simulation.recording import record_run
from spoofgym.simulation.simulator import FilterDiverged, Simulator
from spoofgym.simulation.tight import TightlyCoupledSimulator

from ..envs.support import SHORT
from ..receiver.batches import check_same


def everything(simulator, rows=slice(None)):
    buffers, sensors = simulator.buffers, simulator.sensors
    plain = ("time", "interval", "position_e", "velocity_e", "visible", "coasting")
    arrays = {
        **{name: buffers.fields[name] for name in buffers.fields.shapes},
        **{name: buffers.assumed[name] for name in buffers.assumed.shapes},
        **{f"sensor {name}": sensors.fields[name] for name in sensors.fields.shapes},
        **{f"sensor {name}": sensors.constants[name] for name in sensors.constants.shapes},
        **{f"signal {name}": sensors.signals[name] for name in sensors.signals.shapes},
        **{f"seen {name}": array for name, array in buffers.seen.items()},
        **{f"plain {name}": getattr(buffers, name) for name in plain},
        "epoch": sensors.epoch,
    }
    return {name: np.array(array)[rows] for name, array in arrays.items()}


def played(setup, rows, threads=1):
    """Receivers by their numbers after 20 steps under attack; every third begins again at half."""
    rows, axes = np.asarray(rows), len(setup.action_names)
    engine = Engine(len(rows), setup, threads=threads)
    engine.reset([np.random.default_rng([9, number]) for number in rows])
    for k in range(20):
        if k == 10 and not (rows % 3).all():
            again = np.flatnonzero(rows % 3 == 0)
            engine.reset([np.random.default_rng([10, number]) for number in rows[again]], again)
        engine.step(np.full((len(rows), axes), 0.1 * (k % 3)))
    return {**everything(engine.simulator), "weights": engine.simulator.weights.copy()}


ALL_DRAWN = {
    "start_s": (0.0, 60.0),
    "worlds": 2,
    "turned_deg": (0.0, 360.0),
    "imu": ("aviation", "tactical", "consumer"),
    "errors": ("zhong2025", "trolley", "groves"),
}
SETTINGS = {
    "default": {},
    "general": {
        "receiver": {
            "covariance_update": "general",
            "conventions": "orthonormal",
            "min_satellites": 9,
        },
        "attack": "per-channel",
        "domain": {**ALL_DRAWN, "constellation_time_s": (0.0, 86_400.0)},
    },
    "plain": {"receiver": {"covariance_update": "plain"}, "domain": ALL_DRAWN},
    "airborne": {
        "scenario": {"name": "aviation-actual", "imu_rate_hz": 20},
        "attack": {"name": "false-position", "errors": "quiet"},
        "domain": {
            "start_s": (0.0, 60.0),
            "events": {"clock_step": 0.5, "satellite_loss": 0.5, "front": 0.5},
        },
    },
}


@pytest.fixture(scope="module", params=SETTINGS)
def many(request):
    setup = TightlyCoupledSetup(timeline=SHORT, detector="ewma", **SETTINGS[request.param])
    setup.fields = setup.has
    whole = played(setup, range(70))
    assert (whole["weights"] < 0.99).any()
    assert len(set(whole["epoch"])) > (15 if "domain" in SETTINGS[request.param] else 1)
    if request.param == "general":
        assert 5 < whole["plain coasting"].sum() < 65
    return setup, whole


@pytest.mark.parametrize(
    ("rows", "threads"),
    [(range(7, 8), 1), (range(7), 1), (range(8), 1), (range(9), 1), (range(17), 2), (range(70), 3)],
    ids=str,
)
def test_a_receiver_is_the_same_in_any_batch_and_with_any_threads(many, rows, threads):
    setup, whole = many
    mine = played(setup, rows, threads)
    assert mine["seen innovation_cov"].any()
    check_same(mine, {name: array[rows.start : rows.stop] for name, array in whole.items()})


def test_an_attack_meets_the_same_noise():
    setup = TightlyCoupledSetup(timeline=SHORT, detector=Never())
    setup.fields = frozenset({"pseudorange"})

    def run(size):
        simulator = Engine(2, setup, threads=1).simulator
        simulator.start_episodes([np.random.default_rng(i) for i in range(2)])
        found = []
        for _ in range(20):
            simulator.predict(np.full((2, 2), size))
            fields, sensors = simulator.buffers.fields, simulator.sensors
            bias = np.hstack([fields["accel_bias_b"], fields["gyro_bias_b"]])
            # increments without the biases, which are estimated otherwise under attack
            delta = fields["imu_delta"] + simulator.epoch.interval[:, None] * bias
            # the offset is added after the noise: only the rounding of that sum may differ
            ranges = simulator.epoch.pseudorange - sensors.range_offset * simulator.epoch.visible
            found.append((sensors.fields["residual"].copy(), delta, ranges))
            simulator.update(None)
        return *map(np.array, zip(*found, strict=True)), np.abs(sensors.range_offset).max()

    clean, attacked = run(0.0), run(0.7)
    assert attacked[3] > 1.0
    for one, other, atol in zip(clean[:3], attacked[:3], (0.0, 1e-13, 1e-8), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=atol)


STEPS = {
    "displacement": {"attack": "false-position"},
    "rate": {"attack": {"name": "false-position", "control": "rate"}},
    "code alone": {"attack": "pseudorange-only"},
    "channels": {"attack": {"name": "per-channel", "channels": "S1*"}},
    "channels at a rate": {"attack": {"name": "per-channel", "control": "rate"}},
    "equipment": {"attack": "tracking-1m"},
    "chart without weights": {"detector": {"name": "ewma", "weight_scale": None}},
    "another detector": {"detector": "cusum"},
    "at a rate": {"detector": {"name": "ewma", "threshold_scale": 0.37}},
    "general": SETTINGS["general"],
}


@pytest.mark.parametrize(("name", "receivers"), [("displacement", 1), *((n, 11) for n in STEPS)])
def test_a_step_is_its_two_halves_with_the_judge_between(name, receivers):
    settings = {"timeline": SHORT, "detector": {"name": "ewma"}, **STEPS[name]}
    whole, halves = (Engine(receivers, TightlyCoupledSetup(**settings)) for _ in range(2))
    for engine in (whole, halves):
        engine.reset([np.random.default_rng([5, number]) for number in range(receivers)])
    compiled = whole.simulator._compiled_detector() != NO_FORM
    assert compiled == (name != "another detector")
    rng, axes = np.random.default_rng(6), len(whole.setup.action_names)
    for k in range(12):
        command = None if k == 7 else rng.uniform(-1.0, 1.0, (receivers, axes))
        verdict = whole.step(command)
        halves.predict(command)
        other = halves.judge()
        halves.update(other)
        for mine, theirs in zip(verdict, other, strict=True):
            np.testing.assert_array_equal(mine, theirs)
        np.testing.assert_array_equal(whole.simulator.weights, halves.simulator.weights)
        check_same(everything(whole.simulator), everything(halves.simulator))
        for part in ("attack", "detector"):
            memories = [getattr(engine.simulator, part).memory for engine in (whole, halves)]
            for field in memories[0]:
                np.testing.assert_array_equal(memories[0][field], memories[1][field])


@pytest.mark.parametrize(
    ("name", "receivers", "holding"),
    [
        ("displacement", 1, False),
        ("displacement", 40, True),
        ("never", 9, True),
        *(("channels at a rate", 9, holding) for holding in (True, False)),
        ("another detector", 9, True),
        ("general", 9, False),
    ],
)
def test_live_epochs_are_the_stepwise_run(name, receivers, holding):
    detector = {"name": "ewma", "thresholds": "nominal", "false_alarm": 0.2}
    settings = {"timeline": SHORT, "detector": detector, **STEPS.get(name, {"detector": "never"})}
    fused, stepwise = (Engine(receivers, TightlyCoupledSetup(**settings)) for _ in range(2))
    for engine in (fused, stepwise):
        engine.reset([np.random.default_rng([5, number]) for number in range(receivers)])
        axes = len(engine.setup.action_names)
        engine.step(np.full((receivers, axes), 0.3 if holding else 0.0))
    alarms = []
    for count in (1, 5, 12, 3, 0):
        alarms.append(fused.simulator.live_epochs(count, holding=holding))
        expected = Simulator.live_epochs(stepwise.simulator, count, holding=holding)
        np.testing.assert_array_equal(alarms[-1], expected)
        check_same(everything(fused.simulator), everything(stepwise.simulator))
        for mine, theirs in zip(fused.simulator.verdict, stepwise.simulator.verdict, strict=True):
            np.testing.assert_array_equal(mine, theirs)
    if receivers == 40:
        assert 0 < np.concatenate(alarms).sum() < 21 * 40


def test_an_unsound_verdict_of_live_epochs_is_named_as_that_of_a_step():
    setup = TightlyCoupledSetup(timeline=SHORT, detector={"name": "ewma", "thresholds": "nominal"})
    messages = []
    for live_epochs in (TightlyCoupledSimulator.live_epochs, Simulator.live_epochs):
        engine = Engine(9, setup)
        engine.reset([np.random.default_rng(number) for number in range(9)])
        engine.simulator.live_epochs(2)
        engine.simulator.detector.memory["decay"][4] = np.nan
        with pytest.raises(ValueError, match="receiver 4 of 9") as caught:
            live_epochs(engine.simulator, 6)
        messages.append(str(caught.value))
    assert messages[0] == messages[1]


@pytest.mark.parametrize(("attacked", "grade"), [(False, "aviation"), (True, "consumer")])
def test_an_exported_episode_replays_to_the_same_bits(attacked, grade):
    setup = TightlyCoupledSetup(timeline=SHORT, scenario={"imu": grade}, detector=Never())
    action = np.array([[0.2, -0.9]])
    initial, recording, position_e = record_run(
        setup, np.random.default_rng(3), command=(lambda k: action) if attacked else None
    )
    solution = replay(recording, TightlyCoupled(grade=grade), initial=initial)
    np.testing.assert_array_equal(solution.position_e, position_e)
    engine = Engine(1, setup, threads=1)
    engine.reset([np.random.default_rng(3)])
    for _ in range(setup.steps):
        engine.step(action if attacked else np.zeros((1, 2)))
    np.testing.assert_array_equal(solution.position_e[-1], engine.simulator.buffers.position_e[0])
    np.testing.assert_array_equal(
        solution.sd[-1], np.sqrt(np.diagonal(engine.simulator.buffers.covariance[0]))
    )


EWMA = {"name": "ewma", "thresholds": "nominal"}
VICTIMS = {
    "compiled never": (lambda: TightlyCoupledSetup(timeline=SHORT, detector="never"), 9),
    "compiled ewma": (lambda: TightlyCoupledSetup(timeline=SHORT, detector=EWMA), 9),
    "apart": (
        lambda: TightlyCoupledSetup(
            timeline=SHORT, detector={"name": "snapshot-chi2", "thresholds": "nominal"}
        ),
        9,
    ),
    "loose": (lambda: LooselyCoupledSetup(timeline=SHORT, detector="never"), 2),
    "robot": (lambda: WheeledRobotSetup(detector="never"), 2),
}


@pytest.mark.parametrize("value", [np.nan, np.inf, 9e10])
@pytest.mark.parametrize("name", VICTIMS)
def test_a_filter_that_has_diverged_is_stopped_whatever_the_detector(name, value):
    build, receivers = VICTIMS[name]
    engine = Engine(receivers, build(), threads=1)
    engine.reset([np.random.default_rng(number) for number in range(receivers)])
    engine.step(None)
    simulator = engine.simulator
    if name in ("loose", "robot"):
        simulator.position[1] = value
    else:
        position = simulator.buffers.fields["position_e"].copy()
        position[1] = value
        simulator.buffers.fields["position_e"] = position
    with pytest.raises(FilterDiverged, match=f"receiver 1 of {receivers} has diverged at .* s: "):
        engine.step(None)
