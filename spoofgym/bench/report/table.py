"""Tables and texts: columns that are printed, as Markdown too, and templates of pages."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from itertools import zip_longest
from operator import itemgetter
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, NamedTuple

from ..scores.audit import format_age
from ..scores.statistics import format_number as format_number
from ..scores.statistics import in_percent as in_percent
from ..scores.statistics import interval as interval
from ..scores.statistics import percent as percent

if TYPE_CHECKING:
    from jinja2 import Environment

WIDTH = 180  # characters of a line where the output is no terminal


class Column(NamedTuple):
    """A column: its title, the key of its value in a row or a function of the row, and the function
    that formats the value; None is printed as a dash."""

    title: str
    value: str | Callable[[Any], Any]
    form: Callable[[Any], str] = str

    def text(self, row: Any) -> str:
        value = row[self.value] if isinstance(self.value, str) else self.value(row)
        return "-" if value is None else self.form(value)


class Table:
    """Columns, each a `Column` or its fields in order."""

    def __init__(self, *columns: Sequence[Any]) -> None:
        self.columns = tuple(Column(*column) for column in columns)

    @classmethod
    def of_texts(cls, *titles: str) -> Table:
        """Table whose rows are sequences of texts."""
        return cls(*((title, itemgetter(k)) for k, title in enumerate(titles)))

    @property
    def titles(self) -> tuple[str, ...]:
        return tuple(column.title for column in self.columns)

    def __getitem__(self, title: str) -> Column:
        return self.columns[self.titles.index(title)]

    def texts(self, rows: Iterable[Any]) -> list[tuple[str, ...]]:
        return [tuple(column.text(row) for column in self.columns) for row in rows]

    def json(self, rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Values of the columns that have a key, by it."""
        keys = [column.value for column in self.columns if isinstance(column.value, str)]
        return [{key: row[key] for key in keys} for row in rows]

    def markdown(self, rows: Iterable[Any]) -> str:
        lines = [f"| {' | '.join(self.titles)} |", f"|{'---|' * len(self.columns)}"]
        for texts in self.texts(rows):
            cells = (" ".join(text.split()).replace("|", "\\|") for text in texts)
            lines.append(f"| {' | '.join(cells)} |")
        return "\n".join(lines)

    def lines(self, row: Any, widths: Sequence[int]) -> list[str]:
        """Lines of a row, or of the titles for None, in columns of some widths."""
        texts = self.titles if row is None else self.texts([row])[0]
        columns = [
            wrap(text, width, break_on_hyphens=False)
            for text, width in zip(texts, widths, strict=True)
        ]
        lines = zip_longest(*columns, fillvalue="")
        return ["  ".join(map(str.ljust, line, widths)).rstrip() for line in lines]

    def print(self, title: str, rows: Iterable[Any], *, names: int = 1) -> None:
        """Print the table; its first columns, `names`, are never broken."""
        from rich import box, table
        from rich.console import Console
        from rich.text import Text

        console = Console()
        if not console.is_terminal:
            console = Console(width=WIDTH)
        # as Text, since rich takes a unit in brackets for a style
        shown = table.Table(title=Text(title), title_justify="left", box=box.SIMPLE_HEAD)
        for k, column in enumerate(self.columns):
            head = Text(column.title)
            shown.add_column(head, overflow="fold", no_wrap=k < names)
        for texts in self.texts(rows):
            shown.add_row(*map(Text, texts))
        console.print(shown)


FIELDS = Table.of_texts("", "")  # names and values


def share(digits: int) -> Callable[[float], str]:
    """Proportion in per cent."""
    return lambda value: f"{100.0 * value:.{digits}f}"


def metres(value: float | str | None, none: str = "-") -> str:
    """Metres; a word such as ``unbounded`` stays."""
    return none if value is None else value if isinstance(value, str) else format_number(value)


def yes_no(value: bool) -> str:
    return "yes" if value else "no"


TEMPLATES = Path(__file__).with_name("templates")


@cache
def _environment(folder: Path) -> Environment:
    import jinja2
    import markupsafe

    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        autoescape=jinja2.select_autoescape(("html.j2",), default_for_string=False),
    )
    made.filters |= {
        "breakable": lambda text: markupsafe.Markup(
            re.sub(r"(?<=[,=])(?=\w)|(?=\(\w+[=,])", "<wbr>", str(markupsafe.escape(text)))
        ),
        "age": format_age,
        "g": "{:g}".format,
        "g3": "{:.3g}".format,
        "interval": interval,
        "json": json.dumps,
        "metres": metres,
        "number": format_number,
        "percent": percent,
        "several": lambda values: ", ".join(sorted(set(values))),
    }
    return made


def render_template(name: str, values: Mapping[str, Any], folder: Path = TEMPLATES) -> str:
    """Text of a template, with one end of its last line."""
    return _environment(folder).get_template(name).render(values).rstrip() + "\n"


def texts(name: str) -> Any:
    """Macros of a template, by their names."""
    return _environment(TEMPLATES).get_template(name).module
