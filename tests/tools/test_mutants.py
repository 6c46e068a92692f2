"""Mutants: one change of a line each, drawn by seed, and what became of them in a file."""

import ast
import subprocess
from contextlib import nullcontext
from dataclasses import replace

import pytest
import typer

from tools import mutants
from tools.mutants import KILLED, SURVIVED, draw_mutants, find_changes, read_mutants

TEXT = """
LIMIT: Annotated[int, 3] = 2  # a comment with 1 + 1

def f(a, b):
    if a <= b:
        raise ValueError(f"{a + 1}")
    return (a - b) * 1.5
"""


def test_what_is_changed():
    found = [(each.line, each.kind, each.before, each.after) for each in find_changes("f", TEXT)]
    assert sorted(found) == [
        (2, "constant", "2", "3"),
        (5, "comparison", "<=", "<"),
        (7, "constant", "1.5", "1.875"),
        (7, "operator", "*", "/"),
        (7, "operator", "-", "+"),
        (7, "returned value", "(a - b) * 1.5", "-((a - b) * 1.5)"),
    ]


def test_every_change_of_the_package_leaves_a_program():
    drawn = draw_mutants(mutants.ROOT, 36, 12, 0)
    assert drawn == draw_mutants(mutants.ROOT, 36, 12, 0)
    assert len({(each.file, each.line, each.start, each.kind) for each in drawn}) == 36
    assert sum(each.file.endswith(mutants.KERNELS) for each in drawn) == 12
    assert {each.kind for each in drawn} == {"operator", "comparison", "constant", "returned value"}
    for each in drawn:
        lines = (mutants.ROOT / each.file).read_text().splitlines()
        raw = lines[each.line - 1].encode()
        assert raw[each.start : each.end].decode() == each.before
        lines[each.line - 1] = (raw[: each.start] + each.after.encode() + raw[each.end :]).decode()
        ast.parse("\n".join(lines))
        assert all((mutants.ROOT / folder).is_dir() for folder in mutants.find_tests(each.file))


SUMS, ADD = "spoofgym/receiver/sums.py", "def add(a, b):\n    return a + b\n"


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    root = tmp_path / "project"
    notices = "from spoofgym.receiver.sums import add\ndef test_it(): assert abs(add(1, 2)) == 3\n"
    files = {"spoofgym/__init__.py": "", "spoofgym/receiver/__init__.py": "", SUMS: ADD}
    files["tests/receiver/test_sums.py"] = notices
    for k, folder in enumerate(mutants.ALWAYS):
        files[f"{folder}/test_{k}.py"] = "def test_nothing(): pass\n"
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    for words in (["init", "-q"], ["add", "."], ["commit", "-qm", "all"]):
        name = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
        subprocess.run(["git", *name, *words], cwd=root, check=True)
    monkeypatch.setattr(mutants, "ROOT", root)
    monkeypatch.setattr(mutants, "TESTED", {"spoofgym/receiver": ("tests/receiver",)})
    return root


def test_mutants_are_tried_and_a_run_goes_on(checkout, tmp_path):
    out = tmp_path / "mutants.csv"
    mutants.main(out, count=2, kernels=0)
    operator, returned = sorted(read_mutants(out), key=lambda each: each.kind)
    assert (operator.outcome, operator.test) == (KILLED, "tests/receiver/test_sums.py::test_it")
    assert (returned.outcome, returned.test) == (SURVIVED, "")
    content = out.read_text()
    mutants.main(out)  # nothing is left to do
    assert out.read_text() == content


def test_what_was_killed_before_is_killed_again_or_fails_the_run(checkout, tmp_path, monkeypatch):
    path, before = checkout / SUMS, tmp_path / "before.csv"
    found, changed = (
        {each.kind: each for each in find_changes(SUMS, text)}
        for text in (ADD, ADD.replace("+", "-"))
    )
    # a line that was moved is found, and one that is gone is counted apart
    path.write_text("def add(a, b):\n    if True:\n        return a + b\n")
    gone = changed["operator"]
    assert not mutants.apply(gone, checkout)
    assert mutants.apply(found["operator"], checkout)
    assert path.read_text() == "def add(a, b):\n    if True:\n        return a - b\n"
    for outcome in (mutants.GONE, SURVIVED):
        tried = replace(gone, outcome=outcome)
        monkeypatch.setattr(mutants, "try_mutant", lambda *_, tried=tried: tried)
        mutants.write_mutants(before, [replace(gone, outcome=KILLED)])
        expected = pytest.raises(typer.Exit) if outcome == SURVIVED else nullcontext()
        again = tmp_path / f"{outcome}.csv"
        with expected:
            mutants.main(again, killed_in=before)
        assert [each.outcome for each in read_mutants(again)] == [outcome]
