"""Order, processes, clusters, shards and ends of an experiment: always the same bytes."""

import importlib
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest

from spoofgym.bench.experiments import Cell, Result, Store, parse_shard, run_experiment, runner

from .support import Numbers, content

COMMAND = [sys.executable, "-m", "tests.bench.experiments.support"]


@dataclass(frozen=True)
class Listed(Numbers):
    """Cells of a list, and the order in which they were computed."""

    listed: tuple[Cell, ...] = ()
    order: list = field(default_factory=list)

    def cells(self):
        return self.listed

    def run(self, cell, results, context):
        self.order.append(cell.key)
        return Result(record=[*results])


def test_the_largest_that_is_ready_comes_first_and_sees_what_it_comes_after(tmp_path):
    cells = (
        Cell("small", {}, 1.0),
        Cell("last", {}, 9.0, after=("middle", "small")),
        Cell("middle", {}, 2.0),
        Cell("large", {}, 3.0),
    )
    experiment = Listed(listed=cells)
    results = run_experiment(experiment, Store(tmp_path))
    assert experiment.order == ["large", "middle", "small", "last"]
    assert results["last"].record == ["middle", "small"]
    run_experiment(experiment, Store(tmp_path))
    assert len(experiment.order) == 4


def test_a_group_is_one_call_of_what_is_unfinished_and_contexts_last(tmp_path):
    calls, caches = [], []

    class Grouped(Listed):
        def run_group(self, cells, results, context):
            calls.append([cell.key for cell in cells])
            caches.append(context.cache)
            assert context.threads == 3
            return super().run_group(cells, results, context)

    cells = (*(Cell(key, {}, group="g") for key in "abc"), Cell("d", {}))
    store = Store(tmp_path)
    run_experiment(Grouped(listed=cells), store, threads=3)
    store.build_path("b").unlink()
    run_experiment(Grouped(listed=cells), store, threads=3)
    assert calls == [["a", "b", "c"], ["d"], ["b"]]
    assert caches[0] is caches[1]


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        ((Cell("a", {}), Cell("a", {})), "two cells .* 'a'"),
        ((Cell("a", {}), Cell("A", {})), "two cells .* 'a'"),
        ((Cell("a", {}, after=("b",)),), "cell before 'a'.*'b'"),
        (
            (Cell("a", {}, after=("b",)), Cell("b", {}, after=("a",))),
            "wait for each other: .*cell a",
        ),
    ],
)
def test_cells_that_make_no_sense_are_named(tmp_path, cells, said):
    with pytest.raises(ValueError, match=said):
        run_experiment(Listed(listed=cells), Store(tmp_path))


@pytest.mark.parametrize("jobs", [1, 2])
def test_processes_leave_the_same_bytes_and_progress_adds_up_to_what_is_left(tmp_path, whole, jobs):
    seen, totals = [], []

    @contextmanager
    def bar(total):
        class Bar:
            def advance(self, amount, now):
                seen.append(amount)

        totals.append(total)
        yield Bar()

    run_experiment(Numbers(), Store(tmp_path), jobs=jobs, threads=2, progress=bar)
    assert content(tmp_path) == whole
    assert totals == [sum(cell.work for cell in Numbers().cells())]
    assert sum(seen) == pytest.approx(totals[0])
    Store(tmp_path).build_path("draw-2").unlink()
    for _ in range(2):
        run_experiment(Numbers(), Store(tmp_path), progress=bar)
    assert totals[1:] == [3.0, 0.0]


def test_shards_are_parts_that_need_no_other(tmp_path, whole):
    for n in (2, 5):
        store, done = Store(tmp_path / str(n)), []
        for i in range(n, 0, -1):
            results = run_experiment(Numbers(), store, shard=(i, n))
            done.append(len({*results}))
        assert done == sorted(done)
        assert done[0] <= 6
        assert not results.missing
        assert content(store.path) == whole


def test_connected_cells_share_a_shard_which_is_read_from_text(tmp_path):
    cells = [Cell(f"{k}", {}, work=10.0 - k) for k in range(8)]
    cells += [Cell(f"after {k}", {}, 1.0, after=(f"{k}",)) for k in range(8)]
    sums = []
    for i in (1, 2, 3):
        experiment = Listed(listed=cells)
        run_experiment(experiment, Store(tmp_path / str(i)), shard=(i, 3))
        own = {*experiment.order}
        assert all((f"{k}" in own) == (f"after {k}" in own) for k in range(8))
        sums.append(sum(cell.work for cell in cells if cell.key in own))
    assert sum(sums) == sum(cell.work for cell in cells)
    assert max(sums) - min(sums) <= 5.0
    assert [parse_shard(text) for text in ("1/2", "4/4")] == [(1, 2), (4, 4)]
    for text in ("0/4", "5/4", "1/0", "1", "a/b", "-1/4", "1/2/3", "", "1.5/2"):
        with pytest.raises(ValueError, match="shard"):
            parse_shard(text)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"jobs": 0}, "0"),
        ({"backend": "slurm"}, "slurm"),
        ({"backend": "dask"}, r"python -m pip install 'spoofgym\[dask\]'"),
    ],
)
def test_wrong_settings_are_named_before_anything_is_written(tmp_path, monkeypatch, settings, said):
    def missing(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises((ValueError, ImportError), match=said):
        run_experiment(Numbers(), Store(tmp_path / "out"), **settings)
    assert not (tmp_path / "out").exists()


def test_a_worker_with_other_code_refuses(tmp_path):
    store = Store(tmp_path)
    store.open("numbers", {"size": 3})
    store.check_code()
    store.config["code"]["numpy"] = "1.0"
    with pytest.raises(ValueError, match=r"other code than .* numpy: '.*', not '1.0'"):
        store.check_code()


def test_an_error_comes_through_and_the_rest_stays_of_workers_with_ctrl_c_blocked(tmp_path):
    class Wrong(Listed):
        def run(self, cell, results, context):
            if cell.key == "wrong":
                raise ValueError("it is wrong")
            return Result(record=[int(s) for s in signal.pthread_sigmask(signal.SIG_BLOCK, ())])

    right = Cell("a", {}), Cell("b", {})
    cells = *right, Cell("wrong", {}, after=("a", "b"))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    for jobs in (1, 2):
        store = Store(tmp_path / str(jobs))
        with pytest.raises(ValueError, match="it is wrong"):
            run_experiment(Wrong(listed=cells), store, jobs=jobs)
        for cell in right:
            assert (signal.SIGINT in store.get(cell).record) == (jobs == 2)
    assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == before


def test_a_killed_worker_is_one_line_and_the_same_command_goes_on(tmp_path, whole):
    out, kill = tmp_path / "out", tmp_path / "kill"
    command = [*COMMAND, str(out), "0.05", "2", str(kill)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert kill.exists()
    (line,) = ended.stderr.splitlines()
    assert "a worker was killed" in line
    assert "draw-1" in line
    assert content(out).items() < whole.items()
    run_experiment(Numbers(kills=str(kill)), Store(out))
    assert content(out) == whole


def begun(path):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    how = {"stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    try:
        process = subprocess.Popen([*COMMAND, str(path), "1.0", "2"], **how)
    finally:
        signal.signal(signal.SIGINT, before)
    while not list((path / "cells").glob("*.npz")) and process.poll() is None:
        time.sleep(0.01)
    return process


def wait_for_group(number):
    for _ in range(600):
        os.killpg(number, 0)
        time.sleep(0.1)


@pytest.mark.parametrize("kill", [False, True])
def test_ctrl_c_and_a_kill_keep_what_is_finished_and_end_the_workers(kill, tmp_path, whole):
    process = begun(tmp_path)
    if kill:
        process.kill()
        process.communicate(timeout=120.0)
    else:
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        printed = process.communicate(timeout=120.0)[1]
        line = printed.splitlines()[0]  # loky's tracker may warn after it, of what a worker held
        assert "Traceback" not in printed
        assert process.returncode == 1
        assert "of 8 cells are finished" in line
        assert f"in {tmp_path}; the same command goes on" in line
    with pytest.raises(ProcessLookupError):  # no worker is left
        wait_for_group(process.pid)
    assert content(tmp_path).items() < whole.items()
    run_experiment(Numbers(), Store(tmp_path))
    assert content(tmp_path) == whole


@pytest.mark.nightly
@pytest.mark.filterwarnings("default")  # of dask's own
def test_dask_leaves_the_same_bytes(tmp_path, whole):
    from distributed import LocalCluster

    alone = {"dashboard_address": None, "memory_limit": None}
    with LocalCluster(n_workers=2, threads_per_worker=2, **alone) as cluster:
        run_experiment(Numbers(), Store(tmp_path), backend=f"dask:{cluster.scheduler_address}")
    assert content(tmp_path) == whole


@pytest.mark.filterwarnings("default")  # of dask's own
def test_an_address_that_does_not_answer(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "CONNECT_S", 1.0)
    importlib.import_module("distributed")  # which takes time of its own
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        address = f"127.0.0.1:{listening.getsockname()[1]}"
        with pytest.raises(ConnectionError, match=f"no dask cluster answers at '{address}'"):
            run_experiment(Numbers(), Store(tmp_path), backend=f"dask:{address}")


@pytest.mark.nightly
@pytest.mark.filterwarnings("default")
def test_ray_leaves_the_same_bytes(tmp_path, whole):
    pytest.importorskip("ray")  # `make test-ray` has it
    run_experiment(Numbers(), Store(tmp_path), jobs=2, threads=1, backend="ray")
    assert content(tmp_path) == whole
    with pytest.raises(ConnectionError, match="no ray cluster answers"):
        run_experiment(Numbers(), Store(tmp_path / "none"), backend="ray:127.0.0.1:1")
