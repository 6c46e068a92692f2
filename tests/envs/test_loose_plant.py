"""The loosely coupled plant: the same bits in any batch, an honest filter, clear refusals."""

import copy
import pickle

import numpy as np
import pytest

from spoofgym.detectors import Detector, Verdict
from spoofgym.envs.loose_plant import LoosePlant

SHORT = {"warmup_s": 4.0, "live_s": 3.0, "attack_s": 2.0, "time_to_alert_s": 1.0}
TUNED = {"self_tuning": {"window": 20, "process": "clamped"}}
WHITE = {"horizontal_sd_m": 3.7, "vertical_sd_m": 6.0, "decay": 0.0}


class Weigher(Detector):
    """A detector in the loop: weights that fall with the innovation, an alarm where it is large."""

    paper = "shadmehri2025"
    measures = "position"

    def bind(self, context):
        super().bind(context)
        self.memory.declare("worst", np.zeros(context.receivers))

    def judge(self, epoch):
        size = np.abs(epoch.innovation).max(axis=1, keepdims=True)
        self.memory["worst"] = np.maximum(self.memory["worst"], size[:, 0])
        weights = 1.0 / (1.0 + 0.1 * np.abs(epoch.innovation))
        return Verdict(size, np.full_like(size, 6.0), size > 6.0, weights)


def plant(receivers, **kwargs):
    return LoosePlant(receivers, **{"timeline": SHORT, "detector": Weigher(), **kwargs})


def rngs(rows):
    return [np.random.default_rng(100 + row) for row in rows]


def same(mine, theirs, rows):
    for memory, other in (
        (mine.memory, theirs.memory),
        (mine.detector.memory, theirs.detector.memory),
    ):
        for name in memory.declared:
            np.testing.assert_array_equal(memory[name], other[name][rows], err_msg=name)


@pytest.mark.parametrize("receivers", [1, 3, 17])
def test_a_receiver_is_the_same_in_any_batch(receivers):
    many, few = plant(40, receiver=TUNED), plant(receivers, receiver=TUNED)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 40, 2))
    warm = many.begin(rngs(range(40))), few.begin(rngs(range(receivers)))
    np.testing.assert_array_equal(warm[0][:receivers], warm[1])
    for action in actions:
        alarms = many.advance(action), few.advance(action[:receivers].copy())
        np.testing.assert_array_equal(alarms[0][:receivers], alarms[1])
    same(few, many, np.arange(receivers))
    np.testing.assert_array_equal(many.error_ne()[:receivers], few.error_ne())


def test_no_command_is_the_clean_run():
    attacked, clean = plant(5), plant(5)
    for each in (attacked, clean):
        each.begin(rngs(range(5)))
    for k in range(30):
        attacked.advance(np.zeros((5, 2)))
        clean.advance(None)
        np.testing.assert_array_equal(attacked.error_ne(), clean.error_ne(), err_msg=f"{k}")
    same(attacked, clean, np.arange(5))


def test_an_attack_meets_the_same_noise_and_moves_the_fix():
    attacked, clean = plant(4), plant(4)
    for each in (attacked, clean):
        each.begin(rngs(range(4)))
    for _ in range(10):
        attacked.advance(np.tile([1.0, -0.5], (4, 1)))
        clean.advance(None)
    np.testing.assert_array_equal(attacked.memory["position_error"], clean.memory["position_error"])
    np.testing.assert_array_equal(attacked._victims.samples, clean._victims.samples)
    np.testing.assert_allclose(attacked.memory["displacement"], [[-2.5, 5.0, 0.0]] * 4)
    moved = (attacked._victims.fix_e - clean._victims.fix_e) @ attacked.world.C_el[50]
    np.testing.assert_allclose(moved, [[-2.5, 5.0, 0.0]] * 4, atol=1e-8)
    attacked.advance(None)
    np.testing.assert_allclose(attacked.memory["displacement"], [[-2.75, 5.5, 0.0]] * 4)


def test_receivers_can_be_moved_to_another_batch():
    source, target = plant(6, receiver=TUNED), plant(6, receiver=TUNED).spawn(3)
    source.begin(rngs(range(6)))
    target.begin(rngs(range(50, 53)))
    action = np.random.default_rng(1).uniform(-1.0, 1.0, (6, 2))
    for _ in range(5):
        source.advance(action)
        target.advance(None)
    target.copy_rows(np.array([2, 0]), source, np.array([1, 5]))
    for _ in range(5):
        source.advance(action)
        target.advance(np.ascontiguousarray(action[[5, 0, 1]]))
    np.testing.assert_array_equal(target.error_ne()[[2, 0]], source.error_ne()[[1, 5]])


class FarFix(Weigher):
    """Looks at the fix and the prediction themselves, not at the innovation."""

    needs = frozenset({"gnss_position"})

    def judge(self, epoch):
        apart = epoch.gnss_position - epoch.predicted_position
        size = np.sqrt((apart**2).sum(axis=1, keepdims=True))
        np.testing.assert_allclose(size[:, 0], np.sqrt((epoch.innovation**2).sum(axis=1)))
        return Verdict(size, np.full_like(size, 6.0), size > 6.0)


def test_a_copy_goes_on_by_itself():
    mine = plant(2, receiver=TUNED, detector=FarFix())
    mine.begin(rngs(range(2)))
    copies = [copy.deepcopy(mine), pickle.loads(pickle.dumps(mine))]
    for _ in range(5):
        mine.advance(np.ones((2, 2)))
    for each in copies:
        for _ in range(5):
            each.advance(np.ones((2, 2)))
        same(each, mine, np.arange(2))


def test_episodes_differ_and_repeat():
    mine, again = plant(2), plant(2)
    generators = rngs(range(2))
    mine.begin(generators)
    first = mine.error_ne()
    mine.begin(generators)
    assert not np.array_equal(first, mine.error_ne())
    again.begin(rngs(range(2)))
    np.testing.assert_array_equal(first, again.error_ne())


def test_the_filter_is_honest_where_its_noise_is_the_world_s():
    """NIS of 3 a fix, and errors of the size that the covariance says, apart from the factor 3."""
    runs = 200
    mine = LoosePlant(runs, errors=WHITE, receiver={}, detector="windowed-chi2")
    mine.begin(rngs(range(runs)))
    nis = []
    for _ in range(50):
        mine.advance(None)
        z, S = mine.memory["innovation"], mine.memory["innovation_cov"]
        nis.append(np.einsum("bi,bij,bj->b", z, np.linalg.inv(S), z))
    mean = np.mean(nis)
    assert mean == pytest.approx(3.0, abs=5.0 * np.sqrt(6.0 / np.size(nis)) + 0.05)
    sd = np.sqrt(np.diagonal(mine.memory["covariance"], axis1=1, axis2=2)[:, [7, 6]])
    assert 0.7 < np.sqrt(np.mean((mine.error_ne() / sd) ** 2)) < 1.2


@pytest.mark.parametrize("knowledge", ["blind", "tracking", "oracle"])
def test_observations_have_names_bounds_and_the_values_they_tell(knowledge):
    mine = plant(3)
    names, low, high = mine.observation(knowledge)
    assert len(set(names)) == len(names) == low.size == high.size
    assert np.isfinite(low).all()
    assert np.isfinite(high).all()
    mine.begin(rngs(range(3)))
    out = np.full((3, len(names)), np.nan, dtype=np.float32)
    for _ in range(10):
        mine.advance(np.tile([1.0, -0.4], (3, 1)))
    mine.observe(knowledge, out)
    assert np.isfinite(out).all()
    assert ((low <= out) & (out <= high)).all()
    told = dict(zip(names, out[0], strict=True))
    assert told["own_displacement_north"] == pytest.approx(5.0 / 25.0)
    assert told["own_displacement_east"] == pytest.approx(-2.0 / 25.0)
    assert told["own_rate_east"] == pytest.approx(-0.4)
    assert (told["time_since_onset"], told["time_left"]) == pytest.approx((0.5, 0.5))
    if knowledge != "blind":
        moved = mine.world.C_el[40].T @ (mine.world.position_e[50] - mine.world.position_e[40])
        assert told["target_position_north"] == pytest.approx(moved[1] / 1e4)
        assert told["target_velocity_east"] == pytest.approx(2.0, rel=0.1)
    if knowledge == "oracle":
        assert told["statistic_ratio"] == pytest.approx(mine.memory["statistic"][0] / 6.0)
        assert told["victim_error_north"] == pytest.approx(mine.error_ne()[0, 0] / 25.0)


def test_the_default_warm_up_fills_the_windows():
    mine = LoosePlant(1)
    mine.begin(rngs(range(1)))
    assert mine.detector.memory["seen"][0] > mine.detector.covariance_window
    assert not np.allclose(mine.memory["measurement_cov"][0], np.diag([3.7**2, 3.7**2, 36.0]))
    assert mine.time_s() == pytest.approx(20.0)
    alarms = [mine.advance(np.ones((1, 2)))[0] for _ in range(mine.steps)]
    assert any(alarms[:10])


class Compass(Weigher):
    needs = frozenset({"auxiliary_position"})


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"receivers": 0}, "`receivers` must be at least 1, got 0"),
        ({"rate_limit_mps": 0.0}, "`rate_limit_mps` must be finite and > 0, got 0"),
        ({"errors": {"decays": 0.1}}, "`errors` has no setting 'decays'; valid: horizontal_sd_m"),
        ({"receiver": {"window": 1}}, "`receiver` has no setting 'window'"),
        ({"timeline": {"attack": 1}}, "`timeline` has no setting 'attack'"),
        ({"timeline": {"attack_s": 50.0}}, "an episode takes 75.1 s, but 'shadmehri2025' lasts"),
        ({"flight": "shadmehri"}, "unknown flight 'shadmehri'.*did you mean 'shadmehri2025'"),
        ({"detector": "ewma"}, "Ewma measures satellites, but the receiver measures position"),
        ({"detector": Compass()}, "Compass needs auxiliary_position, which a loosely"),
    ],
)
def test_settings_are_checked_at_birth(kwargs, message):
    with pytest.raises(ValueError, match=message):
        LoosePlant(kwargs.pop("receivers", 1), **kwargs)


def test_another_flight_may_be_flown():
    mine = plant(1, flight="zhong2025")
    mine.begin(rngs(range(1)))
    assert mine.world.samples == 10
    assert np.isfinite(mine.error_ne()).all()
