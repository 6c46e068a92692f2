"""How large the house is: lines, statements and files of each part, against their budgets.

python -m tools.size            # a table
python -m tools.size --check    # fails where a part is over its budget
"""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from rich import print as show
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]


class Size(NamedTuple):
    """Lines as `wc -l` counts them, nodes that are `ast.stmt`, and files; None: no budget."""

    lines: int | None = None
    statements: int | None = None
    files: int | None = None


BUDGETS = {
    "spoofgym": Size(48_000, 26_500, 240),
    "baselines": Size(7_500),
    "agents + train": Size(2_700),
    "tools": Size(3_700),  # 3,400, and the mutants
    "tests": Size(30_000, 20_000),
}


def count_statements(text: str) -> int:
    return sum(isinstance(node, ast.stmt) for node in ast.walk(ast.parse(text)))


def measure_size(part: str, root: Path = ROOT) -> Size:
    """Size of the Python files of one folder, or of several that are joined by `+`."""
    texts = [p.read_text() for name in part.split(" + ") for p in (root / name).rglob("*.py")]
    statements = sum(map(count_statements, texts))
    return Size(sum(text.count("\n") for text in texts), statements, len(texts))


def is_over(size: Size, budget: Size) -> bool:
    return any(most is not None and n > most for n, most in zip(size, budget, strict=True))


def main(
    as_json: Annotated[bool, typer.Option("--json", help="JSON in place of a table.")] = False,
    check: Annotated[bool, typer.Option(help="Exit with 1 where over budget.")] = False,
) -> None:
    """Count, and compare with the budgets."""
    sizes = {part: measure_size(part) for part in BUDGETS}
    over = [part for part in BUDGETS if is_over(sizes[part], BUDGETS[part])]
    if as_json:
        rows = {p: {**s._asdict(), "budget": BUDGETS[p]._asdict()} for p, s in sizes.items()}
        typer.echo(json.dumps({"parts": rows, "over": over}, indent=1))
    else:
        table = Table("part", *Size._fields)
        for part, size in sizes.items():
            pairs = zip(size, BUDGETS[part], strict=True)
            cells = [f"{n:,}" if most is None else f"{n:,} of {most:,}" for n, most in pairs]
            table.add_row(part, *cells, style="red" if part in over else "")
        show(table)
    raise typer.Exit(1 if check and over else 0)


if __name__ == "__main__":
    typer.run(main)
