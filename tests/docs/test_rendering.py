"""The page on pictures: its code and its commands run."""

from __future__ import annotations

import importlib.util
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from spoofgym.cli import app

from .pages import blocks_of, broken_links, run, text_of

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")

pytest.importorskip("matplotlib")
PAGE = "rendering.md"
SMALL = "--warmup-s 20 --live-s 10 --attack-s 6 --time-to-alert-s 2 --out run.gif"
"""What is appended to a command; the last of an option counts."""


def test_the_code_runs_in_its_order(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {}
    for needs, code in blocks_of(PAGE):
        if needs is None or importlib.util.find_spec(needs):
            run(code, PAGE, scope)
    assert "(700, 1120, 3) uint8" in capsys.readouterr().out
    assert Path("ramp.gif").stat().st_size > 10_000


def test_the_first_command_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = re.findall(r"^spoofgym (render .*)$", text_of(PAGE), flags=re.MULTILINE)[0]
    done = CliRunner().invoke(app, shlex.split(f"{first} {SMALL}"))
    assert done.exit_code == 0, done.output
    assert Path("run.gif").stat().st_size > 10_000


def test_every_link_to_a_file_leads_somewhere():
    assert broken_links(PAGE) == []
