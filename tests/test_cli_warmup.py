"""`spoofgym warmup`."""

import json
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from spoofgym.cli.warmup import _play
from spoofgym.core.compile import CACHE_VARIABLE, cache_parent

from .command_line import call, refused

pytestmark = pytest.mark.usefixtures("in_tmp_path")


@pytest.mark.nightly
@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")
def test_after_warmup_another_process_compiles_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
    command = [sys.executable, "-m", "spoofgym", "warmup", "Snapshot-v0", "--json"]
    done = [subprocess.run(command, capture_output=True, check=True) for _ in range(2)]
    runs = [json.loads(each.stdout) for each in done]
    for run in runs:
        assert run["cache"] == str(tmp_path / "cache")
    compiled = [sum(each["compiled"] for each in run["environments"]) for run in runs]
    assert compiled[0] > 0
    assert compiled[1] == 0


def test_warmup_of_all_detectors_says_nothing_of_their_memories(recwarn):
    _play("all detectors", None)
    assert not [str(each.message) for each in recwarn]


def test_warmup_says_where_the_code_is_and_refuses_what_cannot_be_compiled(monkeypatch):
    if not numba.config.DISABLE_JIT:
        text = call("warmup", "spoofgym/Snapshot-v0").output
        assert all(word in text for word in ("spoofgym/Snapshot-v0", "single", "batch"))
        assert f"compiled code is in {cache_parent()}" in text
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 0)
    said = refused("warmup", "Snapshot-v9")
    assert "unknown environment 'spoofgym/Snapshot-v9'; valid: " in said
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    assert "NUMBA_DISABLE_JIT is set" in refused("warmup")
