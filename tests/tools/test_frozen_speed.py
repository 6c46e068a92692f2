"""Both trees are timed in turn, and their ratios are those of the rounds."""

import signal

import pytest
from rich.progress import Progress

from tools import frozen_probe, frozen_speed
from tools.frozen_probe import SPEEDS, Stopwatch


class Fake:
    def __init__(self, tree, log, answer):
        self.tree, self.log, self.answer = tree, log, answer

    def ask(self, **request):
        self.log.append((self.tree, request["what"]))
        return self.answer

    def signal(self, number):
        self.log.append((self.tree, signal.Signals(number).name))


def measured(speeds, log, new):
    old = {"wall": 3.0, "cpu": 6.0}
    with Progress(disable=True) as progress:
        trees = (lambda: Fake("old", log, old)), (lambda: Fake("new", log, new))
        return frozen_speed.measure(*trees, speeds, 3, progress)


def test_the_trees_take_turns_and_only_the_one_that_is_timed_runs():
    log, speeds = [], ["engine 64", "episodes 256, 2 threads"]
    result = measured(speeds, log, {"wall": 2.0, "cpu": 4.0})
    assert [tree for tree, what in log if what == "engine 64"] == [
        *("old", "new"),  # not counted
        *("new", "old", "old", "new", "new", "old"),
    ]
    assert (result["engine 64"]["rounds"], result["engine 64"]["cpu_ratio"]) == (3, 1.5)
    asked = [k for k, (_, what) in enumerate(log) if what in SPEEDS]
    assert len(asked) == 2 * 2 * 4
    for k in asked:
        tree = log[k][0]
        assert log[k - 1 : k + 2 : 2] == [(tree, "SIGCONT"), (tree, "SIGSTOP")]
    assert [what for _, what in log[-4:]] == ["SIGCONT"] * 4
    with pytest.raises(RuntimeError, match="new: no engine"):
        measured(["single env"], log, {"error": "no engine", "traceback": "no engine"})
    assert {*log[-2:]} == {("old", "SIGCONT"), ("new", "SIGCONT")}


def test_ratios_are_medians_of_rounds_and_times_those_of_one_receiver():
    def rounds(clock, *pairs):
        return [[{"cpu": 1.0, "wall": 1.0, clock: x} for x in pair] for pair in pairs]

    few = rounds("cpu", (512e-6, 256e-6), (2304e-6, 256e-6), (768e-6, 256e-6))
    row = frozen_speed.summary({"engine 256": few})["engine 256"]
    assert (row["cpu_ratio"], row["old_cpu_us"]) == pytest.approx((3.0, 3.0))
    assert (row["old_cpu_least_us"], row["new_cpu_us"]) == pytest.approx((2.0, 1.0))
    # a second thread is compared with one by the clock
    one, two = rounds("wall", (4.0, 4.0), (5.0, 5.0)), rounds("wall", (9.0, 4.0), (2.0, 4.0))
    result = frozen_speed.summary({frozen_speed.ENGINE: one, frozen_speed.THREADS: two})
    found = result[frozen_speed.THREADS]
    assert (found["old_over_one_thread"], found["new_over_one_thread"]) == (2.0, 1.0)


@pytest.mark.parametrize("kind", ["engine", "env", "episodes"])
def test_every_kind_is_timed_here(kind, monkeypatch):
    threads = 2 if kind == "episodes" else 1
    speed = frozen_probe.Speed(kind, None if kind == "env" else 8, threads, steps=3)
    monkeypatch.setitem(SPEEDS, "few", speed)
    monkeypatch.setitem(frozen_probe.SOON, "warmup_s", 10.0)
    assert min(Stopwatch().round("few").values()) > 0.0
