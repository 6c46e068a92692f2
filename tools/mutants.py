"""Whether the tests notice a fault: one-line mutants of the package, each with the tests near it.

    python -m tools.mutants --out mutants.csv                  # draws them, or goes on
    python -m tools.mutants --out again.csv --killed-in mutants.csv

A mutant changes one operator, comparison, number or returned value.  They are drawn by seed over
files weighted by their statements, and over the four kinds; a third are in kernels.  Each is tried
in a copy of the checked-out commit, by the tests of its package, then the golden and the
conformance tests, up to the first failure.  The CSV is written when a mutant is done, so that a run
that is broken off goes on with the next one.  A later commit may have moved a mutant's line, which
is found by its text; a mutant whose line is no longer there is counted apart.
"""

from __future__ import annotations

import ast
import csv
import io
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import joblib
import numpy as np
import typer
from rich.console import Console
from rich.progress import track

from spoofgym.core.compile import CACHE_VARIABLE, cache_parent
from spoofgym.core.files import write_file

from .size import count_statements

ROOT = Path(__file__).resolve().parents[1]
TESTED = {
    "spoofgym/receiver": ("tests/receiver",),
    "spoofgym/detectors": ("tests/detectors",),
    "spoofgym/bench/scores": ("tests/bench",),
    "spoofgym/bench/experiments/store.py": ("tests/bench/experiments",),
    "spoofgym/envs": ("tests/envs",),
    "spoofgym/simulation/_kernels.py": ("tests/simulation",),
    "spoofgym/attacks/_kernels.py": ("tests/attacks",),
    "spoofgym/truth/_kernels.py": ("tests/truth", "tests/simulation"),
}
"""Where mutants are drawn from, and the tests that each meets first: of what computes there."""
ALWAYS = ("tests/golden", "tests/conformance")
KERNELS = "kernels.py"
"""What the names of files with kernels end in."""
KILLED, SURVIVED, LATE, GONE = "killed", "survived", "out of time", "line is gone"
OPERATORS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "/"}
VALUES = (ast.BinOp, ast.Compare, ast.Name, ast.Subscript)
"""Returned values that are changed: to their negative, or the opposite."""
COMPARISONS = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
}


@dataclass(frozen=True)
class Mutant:
    """One change of a line, and what became of it."""

    number: int
    file: str
    line: int
    start: int
    end: int
    kind: str
    before: str
    after: str
    text: str
    outcome: str = ""
    seconds: float = 0.0
    test: str = ""


def find_changes(file: str, text: str) -> Iterator[Mutant]:
    """All mutants of a file; annotations, texts and what spans several lines have none."""
    tree, lines = ast.parse(text), text.splitlines()
    skipped = {id(part) for node in ast.walk(tree) for part in _list_skipped(node)}
    for node in ast.walk(tree):
        number = getattr(node, "lineno", 0)
        if id(node) in skipped or not number or number != getattr(node, "end_lineno", 0):
            continue
        raw = lines[number - 1].encode()
        for start, end, kind, after in _list_changes(node, raw):
            before = raw[start:end].decode()
            yield Mutant(0, file, number, start, end, kind, before, after, lines[number - 1])


def _list_changes(node: ast.AST, raw: bytes) -> Iterator[tuple[int, int, str, str]]:
    """Where a node of one line is changed, its kind, and what it becomes."""
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        yield from _between(node.left, node.right, raw, rb"//|[-+*/]", OPERATORS[type(node.op)])
    elif isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARISONS:
        after = COMPARISONS[type(node.ops[0])]
        yield from _between(node.left, node.comparators[0], raw, rb"[<>=!]=|[<>]", after)
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float, bool):
        start, end = node.col_offset, node.end_col_offset or 0
        yield start, end, "constant", _another(node.value)
    elif isinstance(node, ast.Return) and isinstance(node.value, VALUES):
        start, end = node.value.col_offset, node.value.end_col_offset or 0
        word = "not " if isinstance(node.value, ast.Compare) else "-"
        yield start, end, "returned value", f"{word}({raw[start:end].decode()})"


def _between(
    left: ast.expr, right: ast.expr, raw: bytes, pattern: bytes, after: str
) -> Iterator[tuple[int, int, str, str]]:
    """Change of the sign between two operands."""
    start = left.end_col_offset or 0
    found = re.search(pattern, raw[start : right.col_offset])
    if found:
        kind = "comparison" if after in COMPARISONS.values() else "operator"
        yield start + found.start(), start + found.end(), kind, after


def _list_skipped(node: ast.AST) -> Iterator[ast.AST]:
    """Parts of annotations, of f-strings and of what is raised."""
    parts = [getattr(node, name, None) for name in ("annotation", "returns")]
    if isinstance(node, ast.JoinedStr | ast.Raise):
        parts.append(node)
    for part in parts:
        if isinstance(part, ast.AST):
            yield from ast.walk(part)


def _another(value: Any) -> str:
    if isinstance(value, bool):
        return str(not value)
    if isinstance(value, int):
        return str(value + 1)
    return repr(1.0 if value == 0.0 else 1.25 * value)


def draw_mutants(root: Path, count: int, kernels: int, seed: int) -> list[Mutant]:
    """Different mutants, `kernels` of them in kernels, the others anywhere else."""
    files = sorted({p for place in TESTED for p in _list_files(root / place)})
    texts = {path.relative_to(root).as_posix(): path.read_text("utf-8") for path in files}
    sizes = {name: count_statements(text) for name, text in texts.items()}
    rng = np.random.default_rng(seed)
    drawn: list[Mutant] = []
    for wanted, inside in ((kernels, True), (count - kernels, False)):
        names = [name for name in texts if name.endswith(KERNELS) == inside]
        pools = {name: [*find_changes(name, texts[name])] for name in names}
        names = [name for name in names if pools[name]]
        if wanted > sum(map(len, pools.values())):
            raise ValueError(f"there are not {wanted} mutants in {len(names)} files")
        while wanted:
            weights = np.array([sizes[name] for name in names], dtype=float)
            name = names[rng.choice(len(names), p=weights / weights.sum())]
            kinds = sorted({each.kind for each in pools[name]})
            kind = kinds[rng.integers(len(kinds))]
            some = [each for each in pools[name] if each.kind == kind]
            drawn.append(some[rng.integers(len(some))])
            pools[name].remove(drawn[-1])
            names = [name for name in names if pools[name]]
            wanted -= 1
    return [replace(each, number=k) for k, each in enumerate(drawn)]


def _list_files(place: Path) -> list[Path]:
    return [place] if place.is_file() else sorted(place.rglob("*.py"))


def find_tests(file: str) -> list[str]:
    """Folders of tests that a mutant meets, in their order."""
    (near,) = (tests for place, tests in TESTED.items() if (file + "/").startswith(place + "/"))
    return [*near, *ALWAYS]


def apply(mutant: Mutant, root: Path) -> bool:
    """Change the line of a mutant in a checkout; False where no line with its text is there."""
    path = root / mutant.file
    lines = path.read_text("utf-8").splitlines(keepends=True) if path.is_file() else []
    places = [k for k, line in enumerate(lines) if line.strip() == mutant.text.strip()]
    if not places:
        return False
    place = min(places, key=lambda k: abs(k + 1 - mutant.line))
    raw = lines[place].encode()
    moved = len(raw) - len(raw.lstrip()) - (len(mutant.text) - len(mutant.text.lstrip()))
    start, end = mutant.start + moved, mutant.end + moved
    lines[place] = (raw[:start] + mutant.after.encode() + raw[end:]).decode()
    path.write_text("".join(lines), "utf-8")
    return True


def lend_cache(folder: Path) -> Path:
    """Folder of compiled code of its own, with what is compiled already: layers that a mutant does
    not touch."""
    folder.mkdir(mode=0o700)
    for compiled in cache_parent().iterdir():
        (folder / compiled.name).symlink_to(compiled)
    return folder


def try_mutant(mutant: Mutant, root: Path, limit_s: float) -> Mutant:
    """Outcome of a mutant in a copy of the commit that `root` has checked out."""
    with tempfile.TemporaryDirectory(prefix="mutant-") as folder:
        copy = Path(folder) / "checkout"
        subprocess.run(["git", "clone", "-q", str(root), str(copy)], check=True)
        if not apply(mutant, copy):
            return replace(mutant, outcome=GONE)
        own = {"PYTHONPATH": str(copy), CACHE_VARIABLE: str(lend_cache(Path(folder) / "cache"))}
        data = os.environ.get("SPOOFGYM_DATA", str(root.parent / "shared" / "data"))
        began = time.monotonic()
        words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
        process = subprocess.Popen(
            [*words, *find_tests(mutant.file)],
            cwd=copy,
            env={**os.environ, **own, "SPOOFGYM_DATA": data},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            said, _ = process.communicate(timeout=limit_s)
            if process.returncode in (4, 5):  # nothing was tested
                raise RuntimeError(f"pytest can't test {mutant.file}: {said.strip()[-200:]}")
            outcome = SURVIVED if process.returncode == 0 else KILLED
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            said, outcome = process.communicate()[0], LATE
        found = re.findall(r"^(?:FAILED|ERROR) (\S+)", said, flags=re.MULTILINE)
        seconds = round(time.monotonic() - began, 1)
        return replace(mutant, outcome=outcome, seconds=seconds, test=(found or [""])[0])


def read_mutants(file: Path) -> list[Mutant]:
    kinds = {"int": int, "float": float, "str": str}
    with file.open(newline="", encoding="utf-8") as lines:
        return [
            Mutant(**{each.name: kinds[str(each.type)](row[each.name]) for each in fields(Mutant)})
            for row in csv.DictReader(lines)
        ]


def write_mutants(file: Path, mutants: list[Mutant]) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, [each.name for each in fields(Mutant)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(asdict, mutants))
    write_file(file, text.getvalue().encode())


def main(
    out: Annotated[Path, typer.Option(help="CSV of the mutants and what became of them.")],
    count: Annotated[int, typer.Option(min=1, help="Mutants to draw.")] = 120,
    kernels: Annotated[int, typer.Option(min=0, help="How many of them in kernels.")] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Of the draw.")] = 0,
    limit_s: Annotated[float, typer.Option(min=1.0, help="Longest time of one [s].")] = 180.0,
    killed_in: Annotated[Path | None, typer.Option(help="Try those that were killed here.")] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Mutants that are tried at once.")] = 1,
) -> None:
    """Try mutants that are not done yet; exit with 1 where one that was killed before is not."""
    if out.is_file():
        mutants = read_mutants(out)
    elif killed_in is not None:
        before = [each for each in read_mutants(killed_in) if each.outcome == KILLED]
        mutants = [replace(each, outcome="", seconds=0.0, test="") for each in before]
    else:
        mutants = draw_mutants(ROOT, count, kernels, seed)
    write_mutants(out, mutants)
    missing = [k for k, each in enumerate(mutants) if not each.outcome]
    pool = joblib.Parallel(jobs, backend="threading", return_as="generator_unordered")
    tried = pool(joblib.delayed(_try_at)(k, mutants[k], ROOT, limit_s) for k in missing)
    for k, each in track(tried, "mutants", total=len(missing), console=Console(stderr=True)):
        mutants[k] = each
        write_mutants(out, mutants)
    outcomes = (KILLED, SURVIVED, LATE, GONE)
    counts = {each: sum(m.outcome == each for m in mutants) for each in outcomes}
    typer.echo(", ".join(f"{count} {outcome}" for outcome, count in counts.items() if count))
    if killed_in is not None and counts[KILLED] + counts[GONE] < len(mutants):
        raise typer.Exit(1)


def _try_at(place: int, mutant: Mutant, root: Path, limit_s: float) -> tuple[int, Mutant]:
    return place, try_mutant(mutant, root, limit_s)


if __name__ == "__main__":
    typer.run(main)
