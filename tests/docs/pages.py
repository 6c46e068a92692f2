"""Code blocks of a page, and what each of them needs."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"(?:<!-- needs (\w+) -->\n)?```python\n(.*?)```", flags=re.DOTALL)


def text_of(name: str) -> str:
    """A page of the docs."""
    return (ROOT / "docs" / name).read_text()


def blocks_of(name: str) -> list[tuple[str | None, str]]:
    """Module that a block needs, and its code, in their order."""
    return [(needs or None, code) for needs, code in BLOCK.findall(text_of(name))]


def run(code: str, name: str, scope: dict[str, object]) -> None:
    """Run a block after those before it."""
    exec(compile(code, name, "exec"), scope)
