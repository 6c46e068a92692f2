"""A checkpoint brings the files of its training, and no other."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from agents.checkpoint import open_checkpoint, write_checkpoint  # noqa: E402


def test_a_checkpoint_overwrites_no_file_that_is_not_its_own(tmp_path: Path) -> None:
    path, own, config = (tmp_path / name for name in ("c.pt", "best.onnx", "config.json"))
    own.write_bytes(b"best")
    config.write_bytes(b"mine")
    write_checkpoint(path, {"w": torch.zeros(2)}, {"steps": 1}, (own,))
    own.write_bytes(b"later")
    with open_checkpoint(path, (own,)) as (tensors, state):
        assert state == {"steps": 1}
        assert tensors["w"].tolist() == [0.0, 0.0]
    assert own.read_bytes() == b"best"
    for name in ("config.json", "../config.json"):
        write_checkpoint(path, {}, {})
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr(name, b"theirs")
        refused = pytest.raises(ValueError, match=f"c.pt is damaged.*{name}, which is not its own")
        with refused, open_checkpoint(path, (own,)):
            raise AssertionError("it must not be taken over")
        assert config.read_bytes() == b"mine"
