"""Commands that go on in their folder, which holds an experiment; errors of one line."""

from __future__ import annotations

import json
import shlex
import subprocess
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from spoofgym.bench.experiments import (
    Cell,
    Context,
    Experiment,
    Reader,
    Result,
    Store,
    run_experiment,
)
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.core.files import write_file
from spoofgym.core.progress import ProgressBar
from spoofgym.core.reading import parse_json
from spoofgym.core.settings import compute_digest, describe, outside_sources


class Part(NamedTuple):
    """A cell of `Records`: what it depends on besides the library, what makes its record of those
    of the cells before, and their names."""

    identity: Mapping[str, Any]
    make: Callable[[dict[str, Any], Context], Any]
    after: tuple[str, ...] = ()
    work: float = 1.0


class Records(Experiment):
    """Cells that are JSON, each by a function; in a folder they stand beside those of the same name
    that depend on something else."""

    def __init__(self, name: str, config: Mapping[str, Any], parts: Mapping[str, Part]) -> None:
        self.name, self._config, self.parts = name, config, parts
        self.keys = {
            each: f"{each} {compute_digest(part.identity)[:8]}" if part.identity else each
            for each, part in parts.items()
        }
        self._names = {key: each for each, key in self.keys.items()}

    @property
    def config(self) -> Mapping[str, Any]:
        return self._config

    def cells(self) -> list[Cell]:
        return [
            Cell(self.keys[name], part.identity, part.work, tuple(map(self.keys.get, part.after)))
            for name, part in self.parts.items()
        ]

    def run(self, cell: Cell, results: Reader, context: Context) -> Result:
        make = self.parts[self._names[cell.key]].make
        return Result(record=make(self.report(results), context))

    def report(self, results: Reader) -> dict[str, Any]:
        """Records of finished cells by their names."""
        return {self._names[key]: found.record for key, found in results.items()}

    def play(
        self, folder: Path, progress: ProgressBar | None = None, *, jobs: int = 1
    ) -> dict[str, Any]:
        """Make what is missing in a folder; all records."""
        return self.report(run_experiment(self, Store(folder), jobs=jobs, progress=progress))


class Ticks(NamedTuple):
    """Progress of a part of a cell."""

    tick: Callable[[float], None]

    def advance(self, amount: float, now: str) -> None:
        self.tick(amount)


def describe_identity(judge: Evaluator, *specs: Any) -> dict[str, Any]:
    """What scores of some spoofers depend on."""
    return {
        "world": judge.world.config,
        "detector": describe(judge.detector.spec),
        "points": [each._asdict() for each in judge.world.points(judge.detector)],
        "runs": [judge.runs, judge.optima.tuning.runs, judge.entropy],
        "spoofers": describe(specs),
        "outside": outside_sources(*specs, *judge.world.parts),
    }


def learning_versions() -> dict[str, str]:
    """What a training depends on besides the library."""
    return {name: version(name) for name in ("torch", "stable-baselines3", "onnx")}


def json_object(name: str, text: str) -> dict[str, Any]:
    """JSON object of a setting; a ValueError names the setting and what it is."""
    return dict(parse_json(text, f"`{name}`"))


def write_json(path: Path, value: Any, indent: int | None = 1) -> None:
    write_file(path, (json.dumps(value, indent=indent, allow_nan=False) + "\n").encode())


@contextmanager
def error_lines() -> Iterator[None]:
    """End the program with one line where the user has made a mistake, or pressed Ctrl-C."""
    try:
        yield
    except (ValueError, TypeError, OSError, subprocess.SubprocessError) as error:
        raise SystemExit(f"error: {' '.join(str(error).split())}") from error
    except KeyboardInterrupt as error:
        raise SystemExit(str(error) or "interrupted; the same command goes on") from None


def format_command(module: str, args: Any, free: Container[str], last: Sequence[str] = ()) -> str:
    """Command line of a training again: what is not a default and not `free`, and `last`."""
    words = ["--out", args.out.name]
    for item in fields(args):
        value = getattr(args, item.name)
        if item.name not in free and value != item.default:
            words += [f"--{item.name.replace('_', '-')}", str(value)]
    return shlex.join(["python", "-m", module, *words, *last])
