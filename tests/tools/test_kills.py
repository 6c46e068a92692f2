"""Commands that are killed go on to the same bytes, and what differs is found."""

import os
import time
from pathlib import Path

import pytest

from tools import kills


def test_a_command_that_goes_on_after_kills_has_the_same_bytes(tmp_path, monkeypatch):
    found = _kill(tmp_path / "good", monkeypatch, _write_parts)
    assert (found.kills, found.faults) == (3, ())
    assert found.ends >= 1


def test_what_a_kill_has_changed_is_found(tmp_path, monkeypatch):
    found = _kill(tmp_path / "bad", monkeypatch, _write_carelessly)
    assert "out differs" in found.faults


@pytest.mark.nightly
@pytest.mark.parametrize("name", kills.COMMANDS)
def test_a_command_survives_three_kills(name, tmp_path):
    assert kills.kill_often(name, 3, tmp_path).faults == ()


def _kill(folder, monkeypatch, command):
    folder.mkdir()
    monkeypatch.setattr(kills, "play", lambda _: command())
    return kills.kill_often("three", 3, folder)


def _write_parts():
    for k in range(4):
        time.sleep(0.1)
        Path(f"{k}.part").write_text("x" * k)
        os.replace(f"{k}.part", str(k))
    return 0


def _write_carelessly():
    with open("out", "a") as file:
        for _ in range(4):
            time.sleep(0.1)
            print("line", file=file, flush=True)
    return 0
