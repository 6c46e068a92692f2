"""Code blocks of a page, and what each of them needs."""

from __future__ import annotations

import importlib.util
import re
import sys
import types
from collections.abc import Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"(?:<!-- needs (\w+) -->\n)?```python\n(.*?)```", flags=re.DOTALL)


def text_of(name: str) -> str:
    page = ROOT / name
    return (page if page.is_file() else ROOT / "docs" / name).read_text()


def blocks_of(name: str) -> list[tuple[str | None, str]]:
    """Module that a block needs, and its code, in their order."""
    return [(needs or None, code) for needs, code in BLOCK.findall(text_of(name))]


def play(
    name: str, patch: pytest.MonkeyPatch, smaller: Iterable[tuple[str, str]] = ()
) -> types.ModuleType:
    """A module after all blocks of a page but for those that need what is not installed.

    `smaller`: patterns, which have to be on the page, and what stands in their place.
    """
    module = types.ModuleType("page")
    patch.setitem(sys.modules, "page", module)  # pickle looks classes up
    blocks = blocks_of(name)
    assert blocks
    for old, _ in smaller:
        assert any(re.search(old, code) for _, code in blocks), old
    for number, (needs, code) in enumerate(blocks):
        if needs is None or importlib.util.find_spec(needs):
            for old, new in smaller:
                code = re.sub(old, new, code)
            exec(compile(code, f"{name} block {number}", "exec"), module.__dict__)
    return module
