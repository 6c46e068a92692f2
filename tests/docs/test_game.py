"""The page on the game: its code runs, and its links lead somewhere."""

import types

import pytest

from .pages import blocks_of, broken_links, run

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")

NAME = "game.md"


def test_the_code_of_the_page_runs():
    module = types.ModuleType("page")
    for number, (_, code) in enumerate(blocks_of(NAME)):
        run(code, f"{NAME} block {number}", module.__dict__)


def test_links_lead_somewhere():
    assert broken_links(NAME) == []
