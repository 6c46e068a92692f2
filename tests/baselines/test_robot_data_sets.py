"""The paper's data sets: who is attacked, when, and by how much."""

import numpy as np
import pytest

from baselines.robot_data_sets import DATA_SETS, RobotDataSet


def drawn(name, runs, *amount):
    return DATA_SETS[name].offsets([np.random.default_rng(i) for i in range(runs)], *amount)


@pytest.mark.parametrize(
    ("name", "clean", "count"),
    [("psi1", 300, 0), ("psi2", 300, 0), ("jump", 150, 150), ("slow", 150, 150), ("both", 50, 100)],
)
def test_the_attacked_fixes_are_those_that_are_moved(name, clean, count):
    attacked = DATA_SETS[name].mark_attacked()
    np.testing.assert_array_equal(drawn(name, 3).any(axis=(1, 2)), attacked)
    assert attacked.sum() == count
    assert not attacked[:clean].any()
    assert DATA_SETS[name].speed_mps == (0.0 if name == "psi1" else 0.5)


def test_jumps_are_drawn_anew_at_every_fix_slow_changes_add_up_and_windows_are_checked():
    jump = drawn("jump", 200)[150:]
    assert jump.mean() == pytest.approx(20.0, abs=0.01)
    assert jump.var() == pytest.approx(0.1, rel=0.03)
    assert abs(np.corrcoef(jump[0].ravel(), jump[1].ravel())[0, 1]) < 0.15
    steps = np.diff(drawn("slow", 200)[149:], axis=0)
    assert steps.mean() == pytest.approx(0.5, abs=0.005)
    assert steps.var() == pytest.approx(0.05, rel=0.03)
    halves = drawn("slow", 200, 0.5)
    assert halves[-1].mean() == pytest.approx(75.0, abs=0.5)
    assert halves[-1].std() == pytest.approx(np.sqrt(150 * 0.05), rel=0.1)
    both = drawn("both", 50)  # whose second attack begins anew
    assert not both[100:150].any()
    assert both[150].mean() == pytest.approx(0.5, abs=0.1)
    for bad, message in (
        ({"jump_s": ((100.0, 301.0),)}, "within 0 to 300 s, got 100 to 301"),
        ({"slow_s": ((50.0, 50.0),)}, r"begin before it ends, .* got 50 to 50"),
    ):
        with pytest.raises(ValueError, match=message):
            RobotDataSet(**bad)
