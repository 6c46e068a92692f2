"""What a result depends on: code that computes and versions, but no comment, page or text."""

from __future__ import annotations

from pathlib import Path

import pytest

from spoofgym.bench.experiments import Store, identity, run_experiment
from spoofgym.bench.experiments.identity import code_identity, digest_of_sources
from spoofgym.core.settings import digest_of_code

from .support import Numbers, content

CODE = '''
"""A module."""
import math

class Circle:
    """A circle."""

    def area(self, r: float) -> float:
        """Its area."""
        return math.pi * r**2  # not Indiana's
'''


@pytest.fixture
def library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small library that stands for the package."""
    folder = tmp_path / "library"
    for name in ("core.py", "cli/bench.py", "bench/report/table.py", "testing/contract.py"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(CODE)
    monkeypatch.setattr(identity, "LIBRARY", folder)
    monkeypatch.setattr(identity, "cache_parent", lambda: tmp_path / "cache")
    digest_of_sources.cache_clear()
    yield folder
    digest_of_sources.cache_clear()


def in_new_process() -> dict[str, str]:
    digest_of_sources.cache_clear()
    return code_identity()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("  # not Indiana's", ""),
        ('"""Its area."""', '"""Area of a circle."""'),
        ('        """Its area."""\n', ""),
        ('"""A module."""', "# a comment\n"),
        ("math.pi * r**2", "(math.pi\n            * r ** 2)"),
        ('    """A circle."""\n', ""),
    ],
)
def test_comments_docstrings_and_layout_do_not_count(old: str, new: str) -> None:
    assert old in CODE
    assert digest_of_code(CODE.replace(old, new).encode()) == digest_of_code(CODE.encode())


@pytest.mark.parametrize(
    ("old", "new"),
    [("r**2", "r**3"), ("math.pi", "3.2"), ("Circle", "Disc"), ("return", "yield")],
)
def test_code_counts(old: str, new: str) -> None:
    assert digest_of_code(CODE.replace(old, new).encode()) != digest_of_code(CODE.encode())


def test_only_what_computes_voids_results(library: Path) -> None:
    before = in_new_process()
    for name in ("cli/bench.py", "bench/report/table.py", "testing/contract.py"):
        (library / name).write_text("print('another text')")
    (library / "core.py").write_text(f"# an edited comment\n{CODE}")
    (library / "page.md").write_text("a page")
    assert in_new_process() == before
    (library / "core.py").write_text(CODE.replace("r**2", "r**3"))
    assert in_new_process() != before
    (library / "core.py").write_text(CODE)
    assert in_new_process() == before
    (library / "core.py").rename(library / "moved.py")
    assert in_new_process() != before


def test_a_version_voids_results_and_is_named(
    library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    run_experiment(Numbers(), Store(out))
    (library / "core.py").write_text(f"# an edited comment\n{CODE}")
    digest_of_sources.cache_clear()
    before = content(out)
    run_experiment(Numbers(), Store(out))
    assert content(out) == before
    monkeypatch.setattr(identity, "version", lambda name: f"99 of {name}")
    with pytest.raises(ValueError, match=r"code.numpy: '.*', not '99 of numpy'"):
        run_experiment(Numbers(), Store(out))
    assert {*code_identity()} == {"sources", "python", "numpy", "scipy", "numba", "onnxruntime"}


def test_digests_are_kept_and_a_damaged_cache_is_no_harm(library: Path, tmp_path: Path) -> None:
    before = in_new_process()
    kept = tmp_path / "cache" / "sources.json"
    parsed = []

    def parse(source: bytes) -> str:
        parsed.append(source)
        return digest_of_code(source)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identity, "digest_of_code", parse)
        assert in_new_process() == before
        assert not parsed
        for damage in (b"{", b"[]", b""):
            kept.write_bytes(damage)
            assert in_new_process() == before
        assert parsed


def test_further_packages_and_folders_count(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a.py").write_text(CODE)
    more = code_identity(["rich"], [tmp_path / "mine"])
    assert more["rich"]
    assert more["sources"] != code_identity()["sources"]
