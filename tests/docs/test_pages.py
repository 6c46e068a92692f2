"""What all pages of the docs name exists: modules and what is in them, and other pages."""

from __future__ import annotations

import pkgutil
import re

import pytest

from .pages import ROOT

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
NAME = re.compile(r"(?<![\w/])spoofgym(?:\.[A-Za-z]\w*)+")
INVENTED = {"spoofgym.detectors.your_name"}
"""What a reader is to write."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_dotted_name_on_a_page_exists(page):
    for name in sorted(set(NAME.findall(page.read_text())) - INVENTED):
        assert pkgutil.resolve_name(name) is not None, name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_link_on_a_page_leads_somewhere(page):
    targets = re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text())
    assert [target for target in targets if not (page.parent / target).exists()] == []
