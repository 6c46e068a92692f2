"""Run what an experiment has not finished yet: here, in processes, or on a cluster.

Workers write their cells themselves and return keys only.  Whatever ends a run, finished cells
stay, and the same call goes on.  Of cells that are ready the largest comes first.

Shards are parts of all cells, whatever is finished: cells that are connected by `after` or share a
group are in one shard, so that none waits for another; a cell that all others come after, though,
leaves all of them to one shard.
"""

from __future__ import annotations

import asyncio
import heapq
import importlib
import os
import signal
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from graphlib import CycleError, TopologicalSorter
from multiprocessing import resource_tracker
from typing import Any, ClassVar, NamedTuple

import cloudpickle
import numpy as np
from joblib import cpu_count

from ...core.children import ONE_THREAD
from ...core.compile import share_notice
from ...core.progress import ProgressBar, ProgressCallback, RemainingWork, no_progress
from ...core.registry import check_choice, whole_number
from .store import Cell, Reader, Result, Store

BACKENDS = {"local": None, "dask": "dask", "ray": "ray-campaign"}
"""Names, and the extras that install them."""
CONNECT_S = 15.0  # how long an address is waited for
HAND_OVER_S = 5.0  # how long loky's thread may take over the last task before its workers end
LOOK_S = 0.5  # how often a worker looks whether the process that started it is there


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, with a line that says what is finished."""


@dataclass
class Context:
    """What a process has for its cells: `threads` of the engine, None for all useful ones; a
    `cache` from cell to cell; and `tick`, which may be called with a part of the cells' `work` when
    it is done."""

    threads: int | None = None
    cache: dict[Any, Any] = field(default_factory=dict)
    tick: Callable[[float], None] = lambda _: None


class Experiment(ABC):
    """Cells, how one is computed, and what they say together.  It is pickled for workers."""

    name: ClassVar[str]
    outputs: ClassVar[tuple[str, ...]] = ()
    """Names of what its reports are written to, in the folder."""

    @property
    @abstractmethod
    def config(self) -> Mapping[str, Any]:
        """Settings that all cells depend on, JSON."""

    @abstractmethod
    def cells(self) -> Iterable[Cell]:
        """All cells; the same ones in every process."""

    def run(self, cell: Cell, results: Reader, context: Context) -> Result:
        """Compute a cell; `results` has those that it comes after.  Either this or `run_group` has
        to be defined."""
        return next(self.run_group([cell], results, context))

    def run_group(
        self, cells: Sequence[Cell], results: Reader, context: Context
    ) -> Iterator[Result]:
        """Compute the unfinished cells of a group, in their order; bits don't depend on which."""
        return (self.run(cell, results, context) for cell in cells)

    @abstractmethod
    def report(self, results: Reader) -> dict[str, Any]:
        """What finished cells say, JSON; never stored as truth."""


def run_experiment(
    experiment: Experiment,
    store: Store,
    *,
    jobs: int = 1,
    backend: str = "local",
    threads: int | None = None,
    shard: tuple[int, int] | None = None,
    progress: ProgressBar | None = None,
    finished: Callable[[Reader], None] = lambda _: None,
    overwrite: bool = False,
) -> Reader:
    """Compute the cells that are not finished; results of all cells, other shards' too.

    `jobs`: processes of this machine, 1 computes here; `backend`: "local", "dask" or "ray", with
    ":address" on a cluster that runs already; `threads`: of the engine in each process; `shard`:
    (i, n), the i-th of n parts from 1 on; `progress`: opens a bar, such as `show_progress`;
    `finished`: is called with what is finished, first and whenever more is.
    """
    jobs = whole_number("`jobs`", jobs, 1)
    kind = backend.partition(":")[0]
    check_choice("backend", kind, BACKENDS)
    if kind != "local":
        _import_backend(kind)
    store.open(experiment.name, experiment.config, outputs=experiment.outputs, overwrite=overwrite)
    cells = list(experiment.cells())
    plan = _Plan(cells, store, None if shard is None else _check_shard(*shard))
    results = Reader(store, cells)
    with (progress or no_progress)(plan.remaining) as bar, ExitStack() as stack:
        try:
            finished(results)
            if plan.count:
                workers = _workers(experiment, store, backend, min(jobs, plan.count), threads)
                for _ in _run_all(plan, stack.enter_context(workers), store, bar):
                    finished(results)
        except KeyboardInterrupt as error:
            stack.close()  # workers end before anything is said
            left = f"{len(cells) - len(results.missing)} of {len(cells)} cells are finished"
            raise Interrupted(
                f"interrupted: {left} in {store.path}; the same command goes on"
            ) from error
    return results


def parse_shard(text: str) -> tuple[int, int]:
    """Shard of a command line, such as ``"1/2"``."""
    i, slash, n = text.partition("/")
    if not (slash and i.isdecimal() and n.isdecimal()):
        raise ValueError(f"a shard is written i/n, such as 1/4 to 4/4, got {text!r}")
    return _check_shard(int(i), int(n))


def _check_shard(i: int, n: int) -> tuple[int, int]:
    if not 1 <= i <= n:
        raise ValueError(f"a shard must be i/n with i from 1 to n, got {i}/{n}")
    return i, n


# --- what is left ----------------------------------------------------------------------------


class _Task(NamedTuple):
    """Unfinished cells that are computed in one call, and what they may read."""

    cells: tuple[Cell, ...]
    before: tuple[Cell, ...]

    @property
    def work(self) -> float:
        return sum(cell.work for cell in self.cells)

    @property
    def label(self) -> str:
        return self.cells[0].group or self.cells[0].key


class _Plan:
    """Unfinished tasks of a shard in an order that `after` allows."""

    def __init__(self, cells: Sequence[Cell], store: Store, shard: tuple[int, int] | None) -> None:
        known = {cell.key: cell for cell in cells}
        files = Counter(store.build_path(cell.key).name.casefold() for cell in cells)
        for cell in cells:
            if files[store.build_path(cell.key).name.casefold()] > 1:
                raise ValueError(f"two cells have the key, or the file name, of {cell.key!r}")
            for key in cell.after:
                check_choice(f"cell before {cell.key!r}", key, known)
        names = {cell.key: cell.group or f"cell {cell.key}" for cell in cells}
        tasks: dict[str, list[Cell]] = {}
        for cell in cells:
            tasks.setdefault(names[cell.key], []).append(cell)
        edges = {
            name: {names[key] for cell in each for key in cell.after} - {name}
            for name, each in tasks.items()
        }
        if shard is not None:
            work = {name: sum(cell.work for cell in each) for name, each in tasks.items()}
            edges = {name: edges[name] for name in _shard(edges, work, *shard)}
        self._order = TopologicalSorter(edges)
        try:
            self._order.prepare()
        except CycleError as error:
            raise ValueError(f"cells wait for each other: {', '.join(error.args[1])}") from None
        self._tasks = {
            name: _Task(
                tuple(cell for cell in tasks[name] if not store.has(cell)),
                tuple({key: known[key] for cell in tasks[name] for key in cell.after}.values()),
            )
            for name in edges
        }
        self._place = {name: k for k, name in enumerate(edges)}
        self._ready: list[tuple[float, int, str]] = []
        self.count = sum(bool(task.cells) for task in self._tasks.values())
        self.remaining = sum(task.work for task in self._tasks.values())

    def next(self) -> tuple[str, _Task] | None:
        """The largest task that is ready; None if no task is ready, now or at all."""
        while names := self._order.get_ready():
            for name in names:
                task = self._tasks[name]
                if task.cells:
                    heapq.heappush(self._ready, (-task.work, self._place[name], name))
                else:
                    self._order.done(name)
        if not self._ready:
            return None
        name = heapq.heappop(self._ready)[-1]
        return name, self._tasks[name]

    def done(self, name: str) -> None:
        """Let those begin that come after a task."""
        self._order.done(name)


def _shard(
    edges: Mapping[str, set[str]], work: Mapping[str, float], i: int, n: int
) -> Iterator[str]:
    """Tasks of a shard; connected ones go together to the shard with the least work so far."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    place = {name: k for k, name in enumerate(edges)}
    pairs = [(place[name], place[other]) for name in edges for other in edges[name]]
    rows, columns = zip(*pairs, strict=True) if pairs else ((), ())
    shape = len(edges), len(edges)
    graph = coo_array((np.ones(len(pairs)), (rows, columns)), shape)
    count, part = connected_components(graph, directed=False)
    size = np.bincount(part, [*work.values()], count)
    sums, shard_of = np.zeros(n), {}
    for k in np.argsort(-size, kind="stable"):
        shard_of[k] = int(sums.argmin())
        sums[shard_of[k]] += size[k]
    return (name for name, k in place.items() if shard_of[part[k]] == i - 1)


# --- workers ---------------------------------------------------------------------------------


class _Workers(NamedTuple):
    """How tasks are handed out, how many at a time, and what says that a worker was killed."""

    submit: Callable[[_Task, RemainingWork], Future[None]]
    slots: Callable[[], int]
    died: tuple[type[BaseException], ...] = ()


Send = Callable[[_Task], None]  # computes a task, and can be pickled


def _run_all(plan: _Plan, workers: _Workers, store: Store, bar: ProgressCallback) -> Iterator[None]:
    """Run all tasks; yields after each."""
    running: dict[Future[None], tuple[str, _Task, RemainingWork]] = {}
    while True:
        while len(running) < workers.slots() and (found := plan.next()):
            name, task = found
            left = RemainingWork(bar, task.work, task.label)
            left.tick(0.0)
            running[workers.submit(task, left)] = name, task, left
        if not running:
            return
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            try:
                future.result()
            except workers.died as error:
                labels = ", ".join(repr(task.label) for _, task, _ in running.values())
                raise ChildProcessError(
                    f"a worker was killed, or ran out of memory, while {labels} ran; finished "
                    f"cells stay in {store.path}, and the same command goes on"
                ) from error
            name, _, left = running.pop(future)
            left.end()
            plan.done(name)
            yield


def _compute(experiment: Experiment, store: Store, context: Context, task: _Task) -> None:
    """Compute and write the cells of a task that no other process has finished meanwhile."""
    cells = [cell for cell in task.cells if not store.has(cell)]
    if cells:
        results = experiment.run_group(cells, Reader(store, task.before), context)
        for cell, result in zip(cells, results, strict=True):
            store.put(cell, result)


_lock = threading.Lock()  # one task at a time in a worker, however many threads a cluster gives it
_loaded: dict[bytes, tuple[Experiment, Context]] = {}
"""The experiment that this process computes, as it was sent."""


def _work(sent: bytes, threads: int, store: Store, task: _Task) -> None:
    with _lock:
        if sent not in _loaded:
            store.check_code()
            _loaded.clear()
            _loaded[sent] = cloudpickle.loads(sent), Context(threads)
        experiment, context = _loaded[sent]
        _compute(experiment, store, context, task)


@contextmanager
def _workers(
    experiment: Experiment, store: Store, backend: str, jobs: int, threads: int | None
) -> Iterator[_Workers]:
    """Workers of a backend, which end with the block."""
    kind, _, address = backend.partition(":")
    if kind == "local" and jobs == 1:
        context = Context(threads)

        def here(task: _Task, left: RemainingWork) -> Future[None]:
            context.tick = left.tick
            _compute(experiment, store, context, task)
            done: Future[None] = Future()
            done.set_result(None)
            return done

        yield _Workers(here, lambda: 1)
        return
    try:
        sent = cloudpickle.dumps(experiment)
    except (TypeError, AttributeError, RuntimeError) as error:
        raise TypeError(f"{experiment.name} can't be sent to a worker: {error}") from error
    each = threads or (1 if address else max(1, cpu_count() // jobs))
    pool = {"local": _loky, "dask": _dask, "ray": _ray}[kind]
    with pool(partial(_work, sent, each, store), address, jobs, each) as workers:
        yield workers


@contextmanager
def _loky(work: Send, _: str, jobs: int, threads: int) -> Iterator[_Workers]:
    """Processes of this machine."""
    from joblib.externals.loky.backend import get_context
    from joblib.externals.loky.process_executor import BrokenProcessPool, ProcessPoolExecutor

    noticed = get_context().Lock()  # held by the process that has said that it compiles
    share_notice(partial(noticed.acquire, block=False))
    given = os.getpid(), noticed
    env = {**ONE_THREAD}
    pool = ProcessPoolExecutor(jobs, initializer=_initialize_worker, initargs=given, env=env)
    last: list[Future[None]] = []

    def submit(task: _Task, _: RemainingWork) -> Future[None]:
        with _block_ctrl_c():  # this may start workers
            last[:] = [pool.submit(work, task)]
        return last[0]

    try:
        yield _Workers(submit, lambda: jobs, (BrokenProcessPool,))
    finally:
        end = time.monotonic() + HAND_OVER_S
        while last and not (last[0].running() or last[0].done()) and time.monotonic() < end:
            time.sleep(0.001)  # loky's thread fails over a task that it did not take yet
        pool.shutdown(wait=True, kill_workers=True)


@contextmanager
def _block_ctrl_c() -> Iterator[None]:
    """Keep Ctrl-C from processes and threads that start here, from their first instruction on."""
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        yield
        return
    resource_tracker.ensure_running()  # its start unblocks Ctrl-C
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _initialize_worker(parent: int, noticed: Any) -> None:
    """Leave Ctrl-C to the process that started this one, and end when it does, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    share_notice(partial(noticed.acquire, block=False))

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _dask(work: Send, address: str, jobs: int, threads: int) -> Iterator[_Workers]:
    """A cluster of dask, or one on this machine."""
    distributed = _import_backend("dask")
    with ExitStack() as stack:
        where = address
        if not address:
            where = distributed.LocalCluster(
                n_workers=jobs, threads_per_worker=1, dashboard_address=None, memory_limit=None
            )
            stack.enter_context(where)
        else:  # a client would wait for minutes
            try:
                asyncio.run(_reach(distributed.comm.connect, address))
            except (OSError, ValueError, TimeoutError) as error:
                raise _no_answer("dask", address) from error
        client = distributed.Client(where, set_as_default=False)
        stack.enter_context(client)
        pool = client.get_executor(pure=False)
        died = distributed.scheduler.KilledWorker, distributed.CancelledError
        slots = lambda: max(1, len(client.nthreads()))  # noqa: E731
        yield _Workers(lambda task, _: pool.submit(work, task), slots, died)


async def _reach(connect: Any, address: str) -> None:
    comm = await asyncio.wait_for(connect(address, timeout=CONNECT_S), CONNECT_S)
    comm.abort()


@contextmanager
def _ray(work: Send, address: str, jobs: int, threads: int) -> Iterator[_Workers]:
    """A cluster of ray, or one on this machine."""
    ray = _import_backend("ray")
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdecimal():  # ray itself waits for minutes
        try:
            socket.create_connection((host, int(port)), CONNECT_S).close()
        except OSError as error:
            raise _no_answer("ray", address) from error
    local = {} if address else {"num_cpus": jobs * threads, "include_dashboard": False}
    try:
        ray.init(address=address or None, log_to_driver=False, **local)
    except (OSError, ValueError) as error:
        raise _no_answer("ray", address) from error
    try:
        call = ray.remote(num_cpus=threads, max_retries=0)(lambda task: work(task))
        slots = max(1, int(ray.cluster_resources().get("CPU", 1)) // threads)
        errors = ray.exceptions
        died = errors.WorkerCrashedError, errors.NodeDiedError, errors.OutOfMemoryError
        yield _Workers(lambda task, _: call.remote(task).future(), lambda: slots, died)
    finally:
        ray.shutdown()


def _no_answer(kind: str, address: str) -> ConnectionError:
    return ConnectionError(f"no {kind} cluster answers at {address!r} within {CONNECT_S:g} s")


def _import_backend(kind: str) -> Any:
    module = {"dask": "distributed"}.get(kind, kind)
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(
            f"the backend {kind!r} is not installed: python -m pip install "
            f"'spoofgym[{BACKENDS[kind]}]'"
        ) from error
