"""What a result depends on: code that computes and versions, but no comment, page or text."""

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
WORDS = ("cli/bench.py", "bench/report/table.py", "testing/contract.py")


@pytest.fixture
def library(tmp_path, monkeypatch):
    folder = tmp_path / "library"
    for name in ("core.py", *WORDS):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(CODE)
    monkeypatch.setattr(identity, "LIBRARY", folder)
    monkeypatch.setattr(identity, "cache_parent", lambda: tmp_path / "cache")
    yield folder
    digest_of_sources.cache_clear()


def in_new_process():
    digest_of_sources.cache_clear()
    return code_identity()


@pytest.mark.parametrize(
    ("old", "new", "counts"),
    [
        ('"""Its area."""', '"""Area of a circle."""', False),
        ('"""A module."""', "# a comment\n", False),
        ('    """A circle."""\n', "", False),
        ("math.pi * r**2  # not Indiana's", "(math.pi\n            * r ** 2)", False),
        ("r**2", "r**3", True),
        ("math.pi", "3.2", True),
        ("Circle", "Disc", True),
        ("return", "yield", True),
    ],
)
def test_code_counts_and_comments_docstrings_and_layout_do_not(old, new, counts):
    assert old in CODE
    changed = digest_of_code(CODE.replace(old, new).encode())
    assert (changed != digest_of_code(CODE.encode())) == counts


def test_only_what_computes_and_versions_void_results(library, tmp_path, monkeypatch):
    before = in_new_process()
    run_experiment(Numbers(), Store(tmp_path / "out"))
    whole = content(tmp_path / "out")
    for name in WORDS:
        (library / name).write_text("print('another text')")
    (library / "core.py").write_text(f"# an edited comment\n{CODE}")
    (library / "page.md").write_text("a page")
    assert in_new_process() == before
    run_experiment(Numbers(), Store(tmp_path / "out"))
    assert content(tmp_path / "out") == whole
    (library / "core.py").write_text(CODE.replace("r**2", "r**3"))
    assert in_new_process() != before
    (library / "core.py").write_text(CODE)
    assert in_new_process() == before
    assert {*before} == {"sources", "python", "numpy", "scipy", "numba", "onnxruntime"}
    with monkeypatch.context() as patch:
        patch.setattr(identity, "version", lambda name: f"99 of {name}")
        with pytest.raises(ValueError, match=r"code.numpy: '.*', not '99 of numpy'"):
            run_experiment(Numbers(), Store(tmp_path / "out"))
    assert code_identity(["rich"])["rich"]  # a further package
    (library / "core.py").rename(library / "moved.py")
    assert in_new_process() != before


def test_digests_are_kept_and_a_damaged_cache_is_no_harm(library, tmp_path, monkeypatch):
    before, parsed = in_new_process(), []

    def parse(source):
        parsed.append(source)
        return digest_of_code(source)

    monkeypatch.setattr(identity, "digest_of_code", parse)
    assert in_new_process() == before
    assert not parsed
    for damage in (b"{", b"[]", b""):
        (tmp_path / "cache" / "sources.json").write_bytes(damage)
        assert in_new_process() == before
    assert parsed
