"""A slice of the fuzzer, of which each reader reads the whole files of its corpus."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools import fuzz

pytest.importorskip("pandas")


@pytest.mark.parametrize("name", fuzz.READERS)
def test_readers_read_what_is_whole_and_refuse_what_is_damaged(name: str, tmp_path: Path) -> None:
    reader = fuzz.READERS[name]
    for content in reader.corpus():
        path = tmp_path / f"whole{reader.suffix}"
        path.write_bytes(content)
        reader.read(path)
    found = fuzz.fuzz(name, 40, seed=10**6)
    assert len(found) == 40
    assert {*found.values()} <= {"read", "refused"}
    assert "refused" in found.values()


def test_faults_are_reported_by_their_number(monkeypatch: pytest.MonkeyPatch) -> None:
    def read(path: Path) -> None:
        size = len(path.read_bytes())
        if size % 3 == 0:
            raise KeyError("a fault")
        if size % 3 == 1:
            bytearray(8 << 30)
        raise ValueError("no name")

    monkeypatch.setitem(fuzz.READERS, "own", fuzz.Reader(".x", lambda: [b"0123456789"], read))
    found = set(fuzz.fuzz("own", 30).values())
    assert any(each.startswith("KeyError at test_fuzz.py") for each in found)
    assert any(each.startswith("MemoryError at test_fuzz.py") for each in found)
    assert "no file is named: ValueError: no name" in found
