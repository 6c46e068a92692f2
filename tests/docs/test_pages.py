"""What all pages of the docs name exists: modules and what is in them, and other pages."""

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

from .pages import BLOCK, ROOT

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
NAME = re.compile(r"(?<![\w/])spoofgym(?:\.[A-Za-z]\w*)+")
INVENTED = {"spoofgym.detectors.your_name"}
"""What a reader is to write."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_dotted_name_on_a_page_exists_and_its_links_lead_somewhere(page):
    for name in sorted(set(NAME.findall(page.read_text())) - INVENTED):
        assert pkgutil.resolve_name(name) is not None, name
    targets = re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text())
    assert [target for target in targets if not (page.parent / target).exists()] == []


def commands_of(page):
    """Command lines of ``spoofgym`` in the blocks of a page, each with its continuation."""
    blocks = re.findall(r"```(?:console|bash|sh)\n(.*?)```", page.read_text(), flags=re.DOTALL)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    return [line for line in lines if line.startswith("spoofgym ")]


@pytest.fixture
def my_detector(monkeypatch):
    """The module that the README lets its reader write."""
    (code,) = (
        code for _, code in BLOCK.findall((ROOT / "README.md").read_text()) if "class " in code
    )
    module = types.ModuleType("my_detector")
    monkeypatch.setitem(sys.modules, "my_detector", module)
    exec(compile(code, "README.md", "exec"), module.__dict__)


COMMANDS = [(page, line) for page in PAGES for line in commands_of(page)]


IDS = [f"{page.name}-{k}" for k, (page, _) in enumerate(COMMANDS)]
assert len(COMMANDS) > 15


@pytest.mark.parametrize(("page", "line"), COMMANDS, ids=IDS)
def test_a_command_on_a_page_is_understood(page, line, my_detector):
    """Its options exist and take these values; its scenario and detectors do, too."""
    words = shlex.split(line, comments=True)[1:]
    command = typer.main.get_command(app)
    context = command.make_context("spoofgym", list(words))
    while words and hasattr(command, "resolve_command"):  # of click, or of typer's copy of it
        name, command, words = command.resolve_command(context, list(words))
        context = command.make_context(name, list(words), parent=context)
    given = context.params
    assert context.info_name == line.split()[1]
    if given.get("scenario"):
        make_scenario(parse_spec(given["scenario"]))
    detectors = given.get("detector") or ()
    for text in [detectors] if isinstance(detectors, str) else detectors:
        if text != "all" and ".onnx" not in text:
            detector_in_world(parse_spec(text))
