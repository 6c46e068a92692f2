"""What all pages of the docs name exists: modules and what is in them, and other pages."""

import importlib
import pkgutil
import re
import shlex
import sys
import types

import pytest
import typer.main

from spoofgym.cli.app import app
from spoofgym.core.registry import parse_spec
from spoofgym.detectors import detector_in_world
from spoofgym.truth.scenario import make_scenario

from .as_users import PAGES, name_of, steps_of
from .pages import ROOT, blocks_of

NAME = re.compile(r"(?<![\w/])spoofgym(?:\.[A-Za-z]\w*)+")
INVENTED = {"spoofgym.detectors.your_name"}
"""What a reader is to write."""
COMMANDS = sorted(
    {
        step.text.removeprefix(".venv/bin/").replace(
            "make train ARGS=", "python -m train.ppo_spoofer "
        )
        for page in PAGES
        for step in steps_of(page)
        if step.kind == "command"
    }
)
OURS = [line for line in COMMANDS if line.startswith("spoofgym ")]
TRAININGS = [line for line in COMMANDS if line.startswith("python -m train.")]
assert len(OURS) > 15
assert len(TRAININGS) > 5


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=name_of)
def test_a_dotted_name_on_a_page_exists_and_its_links_lead_somewhere(page):
    for name in sorted(set(NAME.findall(page.read_text())) - INVENTED):
        assert pkgutil.resolve_name(name) is not None, name
    targets = re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text())
    assert [target for target in targets if not (page.parent / target).exists()] == []
    # the site takes a line that begins with a per cent sign for a comment, and leaves it out
    assert re.findall(r"^\s*%.*", page.read_text(), re.MULTILINE) == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_figure_of_the_first_suite_stands_unmarked(page):
    """Before a page first names one of T1 to T6 in its text, it says which suite they are of."""
    hidden = r"^ *```.*?^ *```$|`[^`\n]*`|\]\([^)]*\)"
    plain = re.sub(hidden, "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    named = re.search(r"\bT[1-6]\b(?! =).*", plain)  # T3 = 0.6 is a threshold
    assert named is None or "first suite" in plain[: named.end()].lower()


@pytest.mark.parametrize("line", OURS)
def test_a_command_on_a_page_is_understood(line, monkeypatch):
    """Its options exist and take these values; its scenario and detectors do, too."""
    module = types.ModuleType("my_detector")  # which the README lets its reader write
    monkeypatch.setitem(sys.modules, "my_detector", module)
    exec(blocks_of("README.md")[-1][1], module.__dict__)
    words = shlex.split(line)[1:]
    command = typer.main.get_command(app)
    context = command.make_context("spoofgym", list(words))
    while words and hasattr(command, "resolve_command"):  # of click, or of typer's copy of it
        name, command, words = command.resolve_command(context, list(words))
        context = command.make_context(name, list(words), parent=context)
    given = context.params
    assert context.info_name in line.split()[1:3]  # of a group the second word
    if given.get("scenario"):
        make_scenario(parse_spec(given["scenario"]))
    detectors = given.get("detector") or ()
    for text in [detectors] if isinstance(detectors, str) else detectors:
        if text != "all" and ".onnx" not in text:
            detector_in_world(parse_spec(text))


@pytest.mark.parametrize("line", TRAININGS)
def test_a_training_on_a_page_is_understood(line):
    tyro = pytest.importorskip("tyro")
    pytest.importorskip("stable_baselines3")
    name, *words = shlex.split(line)[2:]
    names = vars(importlib.import_module(name))
    named = [names[each] for each in ("Arguments", "Settings") if each in names]
    (kind,) = (each for each in named if each.__module__ == name)
    if "--help" not in words:
        given = shlex.split(words[0]) if len(words) == 1 else words
        assert isinstance(tyro.cli(kind, args=given), kind)
