"""Run the parts of papers in processes; what is done is kept, so that a killed run goes on."""

from __future__ import annotations

import multiprocessing
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
import scipy

import spoofgym

from .frame import Paper, Part, Row, Settings
from .paper import load_paper, parts_of, rows_of, rows_record, runs_of
from .sources import digest_of_modules
from .store import Store
from .work import end_with_parent, work

Say = Callable[[str], None]
"""Told what a user should know."""
Tick = Callable[[float, str], None]
"""Told how much of the work is done more, from 0 to 1, and what it was."""
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Processes share the processors already; one thread each, and the same bits with any `jobs`."""


class PartError(RuntimeError):
    """A part has failed."""


@dataclass(frozen=True)
class Reproduction:
    """A paper, run.

    - `key`: the paper;
    - `paper`: its module;
    - `settings`: of the run;
    - `parts`: what was run;
    - `data`: what each part returned, by its name;
    - `told`: versions and time of each part.
    """

    key: str
    paper: Paper
    settings: Settings
    parts: list[Part]
    data: dict[str, dict[str, Any]]
    told: list[dict[str, Any]]

    def rows(self) -> list[Row]:
        """Figures of the paper beside ours."""
        return rows_of(self.paper, self.data, self.settings)

    def record(self) -> dict[str, Any]:
        """The run as JSON.

        Returns ``paper``, ``runs``, ``seed``, and what `rows_record` gives.
        """
        return {
            "paper": self.key,
            "runs": runs_of(self.parts, self.data),
            "seed": self.settings.seed,
            **rows_record(self.rows()),
        }

    def draw(self, folder: Path) -> list[Path]:
        """The paper's figures, drawn from our runs."""
        import matplotlib

        matplotlib.use("Agg")
        folder.mkdir(parents=True, exist_ok=True)
        return self.paper.figures(self.data, folder)


def versions() -> dict[str, str]:
    """What computes."""
    return {
        "spoofgym": spoofgym.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "numba": numba.__version__,
    }


class PaperRun:
    """Parts of a paper with the folder in which their results are kept.

    - `key`: the paper;
    - `settings`: of the run;
    - `out`: folder of the results of all papers;
    - `parts`: all of them;
    - `store`: where their results lie.
    """

    def __init__(self, key: str, settings: Settings, out: Path) -> None:
        self.key, self.settings = key, settings
        self.paper = load_paper(key)
        self.parts = parts_of(self.paper, settings)
        extent = "quick" if settings.quick else "full"
        self.store = Store(out / key / f"{extent}-seed{settings.seed}")
        paths = {self.store.path(part.name) for part in self.parts}
        if len(paths) < len(self.parts):
            raise ValueError(f"two parts of {self.paper.TITLE} have the same file name")
        self._digest = digest_of_modules({part.function.__module__ for part in self.parts})

    def identity(self, part: Part) -> dict[str, Any]:
        """What has to agree before a stored result is taken."""
        return {
            "part": part.name,
            "settings": part.settings,
            "seed": self.settings.seed,
            "quick": self.settings.quick,
            "sources": self._digest,
        }

    def missing(self, say: Say) -> list[Part]:
        """Parts that have to be run."""
        left = []
        unlike: dict[str, list[str]] = {}
        for part in self.parts:
            try:
                found = self.store.load(part.name)
            except ValueError as error:
                say(str(error))
                found = None
            else:
                if found is not None and found[0] != self.identity(part):
                    mine = self.identity(part)
                    other = [name for name in mine if found[0].get(name) != mine[name]]
                    unlike.setdefault(", ".join(other), []).append(part.name)
                    found = None
            if found is None:
                left.append(part)
        for what, names in unlike.items():
            say(
                f"{self.key}: {len(names)} stored part(s) are of other {what} and run anew: "
                f"{', '.join(names)}"
            )
        return left

    def keep(self, part: Part, result: dict[str, Any], seconds: float) -> None:
        """Store what a part has returned."""
        told = {"versions": versions(), "seconds": seconds}
        self.store.save(part, self.identity(part), told, result)

    def result(self) -> Reproduction:
        """All results, read from the folder."""
        data, told = {}, []
        for part in self.parts:
            found = self.store.load(part.name)
            if found is None:
                raise ValueError(f"part {part.name!r} of {self.key} is not in {self.store.folder}")
            if found[0] != self.identity(part):
                raise ValueError(
                    f"{self.store.path(part.name)} was made from other sources or settings; run "
                    f"`python -m baselines.papers {self.key}` again"
                )
            told.append(found[1])
            data[part.name] = found[2]
        return Reproduction(self.key, self.paper, self.settings, self.parts, data, told)


def run_papers(runs: Sequence[PaperRun], jobs: int, tick: Tick, say: Say) -> list[Reproduction]:
    """Run what is left of some papers.

    `say`: told of stored results that are not taken.
    """
    if jobs < 1:
        raise ValueError(f"`jobs` must be at least 1, got {jobs}")
    left = [(run, part) for run in runs for part in run.missing(say)]
    weights = {id(part): _share(run, part) / len(runs) for run in runs for part in run.parts}
    todo = {id(part) for _, part in left}
    stored = sum(weight for part, weight in weights.items() if part not in todo)
    tick(stored, f"{len(weights) - len(left)} of {len(weights)} parts were stored")
    if left:
        with _pool(min(jobs, len(left))) as pool:
            waiting = {
                pool.submit(work, part.function, part.settings): (run, part) for run, part in left
            }
            while waiting:
                done, _ = wait(waiting, return_when=FIRST_COMPLETED)
                # those that have failed last, so that the others are kept before the error
                ended = sorted((f for f in waiting if f in done), key=lambda f: bool(f.exception()))
                for future in ended:
                    run, part = waiting.pop(future)
                    _take(run, part, future)
                    tick(weights[id(part)], f"{run.key}: {part.name}")
    return [run.result() for run in runs]


def _share(run: PaperRun, part: Part) -> float:
    return part.weight / sum(each.weight for each in run.parts)


def _take(run: PaperRun, part: Part, future: Future[tuple[dict[str, Any], float]]) -> None:
    try:
        result, seconds = future.result()
    except Exception as error:
        raise PartError(f"part {part.name!r} of {run.key} has failed: {error}") from error
    run.keep(part, result, seconds)


@contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that end at once when something goes wrong here."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update({name: value or "1" for name, value in before.items()})
    known = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=end_with_parent)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - known:
            child.terminate()
        raise
    finally:
        pool.shutdown()
        for name, value in before.items():
            if value is None:
                del os.environ[name]
