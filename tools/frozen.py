"""Whether this working tree behaves, to the last bit, as an older commit does, and how fast it is.

``python -m tools.frozen --against COMMIT`` plays every id in every form, and runs the command
lines, in both trees on this machine, and compares all that they return.  What has another name now,
and what is not compared, is in ``frozen_names.toml``.  What the commit did is kept in the user's
cache folder, so that the next comparison with it plays the working tree alone.

``--tolerance 1e-9`` lets numbers of floating point differ by that part of the largest absolute
value of their column; what is counted, flagged or named has to be equal, and so do the steps at
which a value is there.  An alarm that comes an epoch earlier is a difference.

``--speed-of '*'`` plays nothing, and measures both trees in alternate rounds.
"""

from __future__ import annotations

import contextlib
import fcntl
import fnmatch
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import llvmlite.binding
import numba
import numpy as np
import platformdirs
import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from rich.text import Text
from typer import Option

from .frozen_probe import MAIN, SPEEDS, Case
from .frozen_speed import measure, speed_table

ROOT = Path(__file__).parents[1]
PROBE = Path(__file__).with_name("frozen_probe.py")
NAMES = Path(__file__).with_name("frozen_names.toml")
CACHE = Path(platformdirs.user_cache_dir("spoofgym")) / "frozen"
MAX_RESULTS = 4
ROUNDS = 15
FLOAT32 = np.dtype(np.float32)
QUICK_FORMS = (("single", None), ("same_step", 3))
"""What ``--quick`` plays of every id; of the main one, and of what is no id, it plays more."""
ELEMENTS = {"final_obs": "observation", "terminal_observation": "observation"}
"""Keys whose elements have the names of another."""
PARTS = "\x1f"
"""Between the parts of a path within a pattern; an id is one part, with a slash of its own."""
SHOWN, DEVIATIONS_SHOWN = 10, 25
Array = np.ndarray[Any, Any]
Columns = dict[tuple[str, ...], "Column"]
Replies = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Names:
    """The name map."""

    imports: dict[str, str] = field(default_factory=dict)
    renamed: dict[str, dict[str, str]] = field(default_factory=dict)
    added: dict[str, dict[str, str]] = field(default_factory=dict)
    dropped: dict[str, dict[str, str]] = field(default_factory=dict)
    volatile: dict[str, dict[str, str]] = field(default_factory=dict)

    @classmethod
    def load(cls, file: Path) -> Names:
        given, valid = tomllib.loads(file.read_text("utf-8")), cls.__dataclass_fields__
        for table in given:
            if table not in valid:
                raise ValueError(f"{file.name} has the table {table!r}; valid: {', '.join(valid)}")
        for table in ("added", "dropped", "volatile"):
            for scope, keys in given.get(table, {}).items():
                for key, reason in keys.items():
                    if not (isinstance(reason, str) and reason.strip()):
                        where = f"{file.name}: {table} {scope} {key}"
                        raise ValueError(f"{where} needs a reason, got {reason!r}")
        return cls(**given)

    def of(self, id_: str) -> Scope:
        base = id_.partition("+")[0]
        found = [
            [keys for scope, keys in table.items() if fnmatch.fnmatchcase(base, scope)]
            for table in (self.renamed, self.added, self.dropped, self.volatile)
        ]
        return Scope(*({key: x for keys in table for key, x in keys.items()} for table in found))


@dataclass(frozen=True)
class Scope:
    """The name map of one id."""

    renamed: dict[str, str] = field(default_factory=dict)
    added: dict[str, str] = field(default_factory=dict)
    dropped: dict[str, str] = field(default_factory=dict)
    volatile: dict[str, str] = field(default_factory=dict)

    def rename(self, path: tuple[str, ...]) -> tuple[str, ...]:
        whole = PARTS.join(path)
        for old, new in self.renamed.items():
            whole = re.sub(_pattern(old), rf"\1\2{new}", whole)
        return tuple(whole.split(PARTS))

    def is_added(self, path: tuple[str, ...]) -> bool:
        return _holds(path, self.added)

    def is_dropped(self, path: tuple[str, ...]) -> bool:
        return _holds(path, self.dropped)

    def is_volatile(self, path: tuple[str, ...]) -> bool:
        """Whether it may have another value at every run, whatever its name."""
        return _holds(path, self.volatile) or _holds(self.rename(path), self.volatile)


def _holds(path: tuple[str, ...], keys: dict[str, str]) -> bool:
    whole = PARTS.join(path)
    return any(re.search(_pattern(key), whole) for key in keys)


def _pattern(key: str) -> str:
    several = re.escape(key).replace("/", f"[/{PARTS}]")
    return rf"(^|{PARTS})(_?){several}(?=$|{PARTS}|\s)"


@dataclass(frozen=True)
class Column:
    """Values of one key over steps."""

    steps: Array
    values: Array
    types: tuple[str, ...]


@dataclass(frozen=True)
class Difference:
    """The first place at which a column differs, and at how many it does."""

    id: str
    form: str
    batch: int | None
    step: int | None
    key: str
    old: str
    new: str
    places: int = 1

    def __str__(self) -> str:
        where = [self.id, self.form, "" if self.batch is None else f"B={self.batch}"]
        where += ["" if self.step is None else f"step {self.step}", self.key]
        more = f" ({self.places} places)" if self.places > 1 else ""
        return f"{' '.join(filter(None, where))}: {self.old} -> {self.new}{more}"


def load_record(file: Path) -> Columns:
    with np.load(file) as stored:
        about = json.loads(str(stored["about"]))
        columns: Columns = {}
        for i, each in enumerate(about["columns"]):
            values, path = stored[f"c{i}"], tuple(each["path"])
            steps, types = np.array(each["steps"]), tuple(each["types"])
            keys = (ELEMENTS.get(part, part) for part in path)
            names = next((about["names"][key] for key in keys if key in about["names"]), None)
            if names is None or values.shape[-1:] != (len(names),):
                columns[path] = Column(steps, values, types)
            else:
                for k, name in enumerate(names):
                    columns[(*path, name)] = Column(steps, values[..., k], types)
        for key, names in about["names"].items():
            columns[("names", key)] = Column(np.array([-1]), np.array([names]), ("names",))
    return columns


@dataclass(frozen=True)
class Deviation:
    """By how much the numbers of a column differ at most, where they may: as a part of the largest
    absolute value of the column in its case, and in the column's own unit."""

    case: str
    key: str
    ratio: float
    absolute: float
    within: bool


@dataclass
class Tolerance:
    """What floating-point numbers may differ by, as in `Deviation`, the `worst` of each column so
    far, and the cases in which a number differs at all."""

    relative: float = 0.0
    absolute: float = 0.0
    worst: dict[str, Deviation] = field(default_factory=dict)
    inexact: set[str] = field(default_factory=set)

    def unequal(self, old: Array, new: Array) -> Array:
        """Where two arrays of one shape differ by too much; NaN equals NaN.  Without a tolerance
        0.0 is not -0.0.  Numbers that were rounded to single precision may have gone to its next
        number."""
        if old.dtype.kind != "f":
            return np.asarray(old != new)
        nan = np.isnan(old) & np.isnan(new)
        if not (self.relative or self.absolute):
            return np.asarray(~(((old == new) & (np.signbit(old) == np.signbit(new))) | nan))
        limit = np.maximum(self.relative * largest(old, new), self.absolute)
        if old.dtype == FLOAT32:
            limit = limit + np.spacing(np.maximum(np.abs(old), np.abs(new)))
        near = np.abs(_difference(old, new)) <= limit
        return np.asarray(~((old == new) | near | nan))

    def note(self, case: Case, key: str, old: Array, new: Array, *, within: bool) -> None:
        off = np.abs(_difference(old, new))
        off = off[np.isfinite(off)]
        if off.size and off.max() > 0.0:
            self.inexact.add(case.name)
            absolute = float(off.max())
            found = Deviation(case.name, key, absolute / largest(old, new), absolute, within)
            if key not in self.worst or found.ratio > self.worst[key].ratio:
                self.worst[key] = found


def largest(old: Array, new: Array) -> float:
    sizes = np.abs(np.stack([old, new]).astype(np.float64))
    return float(np.max(sizes, where=np.isfinite(sizes), initial=0.0))


def _difference(old: Array, new: Array) -> Array:
    with np.errstate(invalid="ignore"):  # of infinities
        return np.asarray(new.astype(np.float64) - old.astype(np.float64))


def compare(
    case: Case, old: Columns, new: Columns, scope: Scope, tolerance: Tolerance
) -> list[Difference]:
    """All columns that differ, those first that do so first."""
    found: list[Difference] = []
    old, new = ({p: c for p, c in each.items() if not scope.is_volatile(p)} for each in (old, new))

    def differs(step: int | None, key: str, was: Any, is_: Any, places: int = 1) -> None:
        found.append(Difference(*case, step, key, str(was), str(is_), places))

    expected = {scope.rename(path): path for path in old if not scope.is_dropped(path)}
    for path in new:
        free = scope.is_added(path)
        if scope.is_dropped(path) and not free:
            differs(None, "/".join(path), "declared as dropped", "still there")
        elif path not in expected and not free:
            differs(None, "/".join(path), "missing", _brief(new[path]))
    # flags and counts first: where they differ, an event has moved, and numbers follow it
    for path, before in sorted(expected.items(), key=lambda item: _is_float(old[item[1]])):
        key = "/".join(path)
        if scope.is_added(path):
            differs(None, key, _brief(old[before]), "declared as added")
        elif path not in new:
            differs(None, key, _brief(old[before]), "missing")
        elif path[0] == "names":
            names = [(name,) for name in old[before].values[0]]
            was = ["/".join(scope.rename(name)) for name in names if not scope.is_dropped(name)]
            now = [str(name) for name in new[path].values[0] if not scope.is_added((name,))]
            if was != now:
                differs(None, f"names of the {path[1]}", ", ".join(was), ", ".join(now))
        else:
            _compare_column(case, key, old[before], new[path], tolerance, differs)
    return sorted(found, key=lambda each: -2 if each.step is None else each.step)


def _is_float(column: Column) -> bool:
    return column.values.dtype.kind == "f"


def _brief(column: Column) -> str:
    return f"{column.values.flat[0]} ({column.values.dtype})" if column.values.size else "empty"


def _compare_column(
    case: Case, key: str, old: Column, new: Column, tolerance: Tolerance, differs: Any
) -> None:
    kinds = [
        (*c.types, c.values.dtype.kind if c.values.dtype.kind == "U" else str(c.values.dtype))
        for c in (old, new)
    ]
    if kinds[0] != kinds[1]:
        differs(None, key, " ".join(kinds[0]), " ".join(kinds[1]))
    elif not np.array_equal(old.steps, new.steps):
        alone = np.setxor1d(old.steps, new.steps)
        first = int(alone[0]) if alone.size else None
        there = ["there" if first in c.steps else "missing" for c in (old, new)]
        if first is None:
            there = [f"{len(c.steps)} times" for c in (old, new)]
        differs(first, key, *there, max(len(alone), 1))
    elif old.values.shape != new.values.shape:
        differs(None, key, f"shape {old.values.shape[1:]}", f"shape {new.values.shape[1:]}")
    else:
        wrong = np.argwhere(tolerance.unequal(old.values, new.values))
        if _is_float(old):
            tolerance.note(case, key, old.values, new.values, within=not len(wrong))
        if len(wrong):
            at = tuple(wrong[0])
            place = "".join(f"[{i}]" for i in at[1:])
            pair = [repr(c.values[at].item()) for c in (old, new)]
            differs(int(old.steps[at[0]]), key + place, *pair, len(wrong))


def git(*words: str) -> str:
    command = ["git", "-C", str(ROOT), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise typer.BadParameter(f"git {' '.join(words)}: {done.stderr.strip()}")
    return done.stdout.strip()


@contextlib.contextmanager
def old_tree(commit: str, keep: bool) -> Iterator[Path]:
    """Git worktree of a commit: temporary, or one that is kept with its compiled code."""
    if keep:
        tree = CACHE / "trees" / commit[:16]
        tree.parent.mkdir(parents=True, exist_ok=True)
        with tree.with_suffix(".lock").open("w") as lock:  # another run may want it, too
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not (tree / ".complete").exists():
                shutil.rmtree(tree, ignore_errors=True)
                git("worktree", "prune")
                git("worktree", "add", "--detach", str(tree), commit)
                (tree / ".complete").touch()
        yield tree
        return
    folder = tempfile.mkdtemp(prefix="spoofgym-frozen-")
    tree = Path(folder) / "tree"
    try:
        git("worktree", "add", "--detach", str(tree), commit)
        yield tree
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        git("worktree", "prune")


class Child:
    """The probe in one tree, which answers requests one after another."""

    def __init__(self, tree: Path, imports: dict[str, str], compiled: Path | None = None) -> None:
        self.tree, self.imports = tree, imports
        own = {} if compiled is None else {"SPOOFGYM_CACHE_DIR": str(compiled)}
        self._folder = tempfile.TemporaryDirectory()
        self._process = subprocess.Popen(
            [sys.executable, str(PROBE)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=self._folder.name,
            env={**os.environ, **own, "PYTHONPATH": str(tree)},
        )
        self._in, self._out = self._process.stdin, self._process.stdout

    def ask(self, **request: Any) -> dict[str, Any]:
        self.send(**request)
        return self.receive()

    def send(self, **request: Any) -> None:
        self._request = request
        with contextlib.suppress(BrokenPipeError):  # seen when the answer is missing
            self._in.write(json.dumps({**request, "imports": self.imports}) + "\n")
            self._in.flush()

    def signal(self, number: int) -> None:
        self._process.send_signal(number)

    def receive(self) -> dict[str, Any]:
        line = self._out.readline()
        if not line:
            status = self._process.wait()
            raise RuntimeError(f"the probe of {self.tree} ended with {status} at {self._request}")
        reply: dict[str, Any] = json.loads(line)
        return reply

    def cases(self) -> list[Case]:
        reply = self.ask(do="cases")
        if "error" in reply:
            raise RuntimeError(f"{self.tree} can't be probed:\n{reply['traceback']}")
        package = Path(reply["package"])
        if not package.is_relative_to(self.tree):
            raise RuntimeError(f"the probe of {self.tree} has imported {package}")
        return [Case(*each) for each in reply["cases"]]

    def close(self) -> None:
        with contextlib.suppress(BrokenPipeError):
            self._in.close()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()


def results_folder(commit: str) -> Path:
    """Where the old results are kept: of this commit, probe, processor and these versions."""
    key = {
        "probe": hashlib.sha256(PROBE.read_bytes()).hexdigest(),
        "cpu": llvmlite.binding.get_host_cpu_name(),
        "versions": [sys.version, numba.__version__, np.__version__],
        "numba": {name: os.environ[name] for name in sorted(os.environ) if "NUMBA" in name},
    }
    digest = hashlib.sha256(json.dumps(key).encode()).hexdigest()[:16]
    folder = CACHE / "results" / f"{commit[:16]}-{digest}"
    folder.mkdir(parents=True, exist_ok=True)
    os.utime(folder)
    used = sorted(folder.parent.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in used[MAX_RESULTS:]:
        shutil.rmtree(path, ignore_errors=True)
    return folder


def is_wanted(case: Case, quick: bool, only: Sequence[str] = ()) -> bool:
    if only:
        return any(fnmatch.fnmatchcase(case.name, each) for each in only)
    return (
        not quick
        or (case.form, case.batch) in (*QUICK_FORMS, ("shipped", None))
        or (case.id == MAIN and case.batch in (None, 3))
        or not (case.id.startswith("spoofgym/") or "+" in case.id)
    )


@dataclass
class Report:
    """What has come out."""

    commit: str
    cases: list[str] = field(default_factory=list)
    ends: int = 0
    differences: list[Difference] = field(default_factory=list)
    inexact: list[str] = field(default_factory=list)
    deviations: list[Deviation] = field(default_factory=list)
    speed: dict[str, dict[str, float]] = field(default_factory=dict)


def missing_cases(
    old: Sequence[Case], new: Sequence[Case], names: Names
) -> tuple[list[Case], list[Difference]]:
    """Cases of both trees, and those that only one has although the map does not say so."""
    found = []
    for case in dict.fromkeys([*old, *new]):
        scope = names.of(case.id)
        if case in old and case not in new and not scope.is_dropped((case.base,)):
            found.append(Difference(*case, None, "the id or form", "there", "missing"))
        if case in new and case not in old and not scope.is_added((case.base,)):
            found.append(Difference(*case, None, "the id or form", "missing", "there"))
    return [case for case in old if case in new], found


def examine(
    commit: str,
    wanted: Any,
    tolerance: Tolerance,
    keep: bool,
    speeds: Sequence[str],
    rounds: int,
    progress: Progress,
) -> Report:
    """Play and compare; without `wanted` only measure."""
    names, report, folder = Names.load(NAMES), Report(commit), results_folder(commit)
    with contextlib.ExitStack() as stack:
        out = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        trees: list[Path] = []

        def start(*where: Any) -> Child:
            child = Child(*where)
            stack.callback(child.close)
            child.cases()  # imports the package, and sees to it that it is that of the tree
            return child

        def start_old() -> Child:
            if not trees:
                trees.append(stack.enter_context(old_tree(commit, keep)))
            return start(trees[0], {}, trees[0].parents[int(keep)] / "compiled")

        start_new = partial(start, ROOT, names.imports)
        if speeds:
            report.speed = measure(start_old, start_new, speeds, rounds, progress)
        if wanted is None:
            return report
        new = start_new()
        old, known = None, folder / "cases.json"
        if not known.exists():
            old = start_old()
            known.write_text(json.dumps(old.cases()))
        before = [case for each in json.loads(known.read_text()) if wanted(case := Case(*each))]
        after = [case for case in new.cases() if wanted(case)]
        both, report.differences = missing_cases(before, after, names)
        task = progress.add_task("cases", total=len(both))
        for case in both:
            progress.update(task, description=case.name)
            name = f"{case.name.replace('/', '--')}.npz"
            files = {"old": folder / name, "new": out / name}
            children = {"new": new}
            if not files["old"].exists():
                children["old"] = old = old or start_old()
            for tree, child in children.items():  # both at the same time
                child.send(do="run", case=case, out=str(files[tree]))
            replies = {tree: child.receive() for tree, child in children.items()}
            report.ends += replies["new"].get("ends", 0)
            report.differences += judge(case, files, replies, names, tolerance)
            files["new"].unlink(missing_ok=True)
            report.cases.append(case.name)
            progress.advance(task)
    report.inexact = sorted(tolerance.inexact)
    report.deviations = sorted(tolerance.worst.values(), key=lambda each: -each.ratio)
    return report


def judge(
    case: Case, files: dict[str, Path], replies: Replies, names: Names, tolerance: Tolerance
) -> list[Difference]:
    """Differences of one case, an error in either tree among them."""
    errors = [replies.get(tree, {}).get("error", "plays") for tree in ("old", "new")]
    if errors != ["plays", "plays"]:
        return [Difference(*case, None, "error", *errors)]
    old, new = load_record(files["old"]), load_record(files["new"])
    return compare(case, old, new, names.of(case.id), tolerance)


app = typer.Typer(add_completion=False, context_settings={"help_option_names": ["-h", "--help"]})


@app.command()
def main(
    against: Annotated[str, Option(help="Commit whose behaviour is to be kept.")],
    quick: Annotated[
        bool, Option("--quick", help="Play a part of it, without speed: some minutes.")
    ] = False,
    only: Annotated[
        list[str] | None,
        Option(
            help="Only cases like this, such as 'Snapshot-v0/*', '*/sb3/17' or 'evaluate*'; may be "
            "repeated."
        ),
    ] = None,
    tolerance: Annotated[
        float,
        Option(
            min=0.0,
            help="What numbers of floating point may differ by in every case, relative to their "
            "column's largest absolute value; flags, counts and texts have to be equal.",
        ),
    ] = 0.0,
    absolute: Annotated[
        float, Option(min=0.0, help="The same in the column's own unit; the larger of both holds.")
    ] = 0.0,
    speed: Annotated[
        bool | None, Option(help="Compare speed too.  Default: unless --quick or --only is given.")
    ] = None,
    speed_of: Annotated[
        str | None, Option(help=f"Compare only speed, of what is like this: {', '.join(SPEEDS)}.")
    ] = None,
    rounds: Annotated[int, Option(min=3, help="Pairs of rounds of the speed.")] = ROUNDS,
    keep: Annotated[
        bool,
        Option(
            "--keep",
            help="Keep the commit's tree and its compiled code in the cache folder, and use what "
            "is there.",
        ),
    ] = False,
    json_: Annotated[bool, Option("--json", help="Print JSON, and nothing else.")] = False,
) -> None:
    """Compare what this working tree does with what a commit did; exit with 1 if it differs."""
    commit = git("rev-parse", "--verify", f"{against}^{{commit}}")
    speeds = [what for what in SPEEDS if fnmatch.fnmatchcase(what, speed_of or "*")]
    if not speeds:
        message = f"no measurement is like {speed_of!r}; there are {', '.join(SPEEDS)}"
        raise typer.BadParameter(message, param_hint="--speed-of")
    if not (speed_of or (not (quick or only) if speed is None else speed)):
        speeds = []
    wanted = None if speed_of else lambda case: is_wanted(case, quick, only or ())
    allowed = Tolerance(tolerance, absolute)
    try:
        with Progress(console=Console(stderr=True, quiet=json_), transient=True) as progress:
            report = examine(commit, wanted, allowed, keep, speeds, rounds, progress)
    except RuntimeError as error:  # of a probe: nothing has been compared to the end
        print(error, file=sys.stderr)
        raise typer.Exit(2) from error
    if not (report.cases or report.differences or speed_of):
        raise typer.BadParameter(f"no case is like {', '.join(only or ())!r}", param_hint="--only")
    if json_:
        print(json.dumps(asdict(report), indent=2))
    else:
        show(report)
    raise typer.Exit(1 if report.differences else 0)


def show(report: Report) -> None:
    console = Console(soft_wrap=True, highlight=False)
    if not console.is_terminal:
        console.width = 180
    for case in dict.fromkeys((each.id, each.form, each.batch) for each in report.differences):
        found = [each for each in report.differences if (each.id, each.form, each.batch) == case]
        for difference in found[:SHOWN]:
            console.print(str(difference), markup=False)
        if len(found) > SHOWN:
            console.print(f"{Case(*case).name}: {len(found) - SHOWN} differences more")
    if report.deviations:
        table = Table("column", "of its largest", "absolute", "", "case", title="worst deviations")
        for each in report.deviations[:DEVIATIONS_SHOWN]:
            sizes = (f"{each.ratio:.1e}", f"{each.absolute:.1e}")
            table.add_row(Text(each.key), *sizes, "" if each.within else "TOO LARGE", each.case)
        console.print(table)
    if report.speed:
        console.print(speed_table(report.speed))
    if report.cases:
        differ = {Case(each.id, each.form, each.batch).name for each in report.differences}
        bits = len({*report.cases} - differ - {*report.inexact})
        console.print(
            f"{len(report.cases)} cases against {report.commit[:12]}, {report.ends} ends of "
            f"episodes: {bits} equal to the last bit, {len({*report.cases} - differ) - bits} "
            f"within the tolerance, {len(differ)} with {len(report.differences)} differences"
        )


if __name__ == "__main__":
    app()
