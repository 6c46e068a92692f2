"""What a reproduction of a paper is made of: parts that run, and rows that compare.

A module ``baselines.papers.<key>`` names its parts, each a function with its settings that runs in
a process of its own.  From what all parts return it makes rows, one per published figure, with the
paper's value, ours, and a band that says where it comes from.  What a row says of the two values,
`Row.printed_inside` and `Row.agrees`, follows here and nowhere else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Protocol

from spoofgym.core.registry import check_choice

Kind = Literal["tolerance", "independent", "bound"]
KINDS: tuple[Kind, ...] = ("tolerance", "independent", "bound")
"""What a band is made from, see `Origin`."""


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    - `quick`: whether to do with few runs: about a minute instead of ten;
    - `seed`: all chance follows from this number.
    """

    quick: bool
    seed: int


@dataclass(frozen=True)
class Part:
    """One unit of work, stored when it is done.

    - `name`: unique within the paper;
    - `function`: of a module, so that another process finds it; returns a dict of numbers, lists or
      arrays;
    - `settings`: its keyword arguments, as JSON has them, the seed among them.  ``runs`` here or in
      what is returned is the number of its simulated runs; a part that tells none counts as one;
    - `weight`: relative duration, for the progress bar.
    """

    name: str
    function: Callable[..., dict[str, Any]]
    settings: dict[str, Any] = field(default_factory=dict)
    weight: float = 1.0


@dataclass(frozen=True)
class Origin:
    """Where a band comes from, and so what it says when a value lies inside.

    - `kind`: ``tolerance``, ``independent``, ``bound``: how far a reproduction may be from the
      paper: a margin around the printed value, or the spread of our runs; what a second, separately
      written program found; or a limit from theory or of our own;
    - `text`: in full: whose runs, how many, which seeds, what varies between them, how wide and
      why. White space is that of running text.
    """

    kind: Kind
    text: str

    def __post_init__(self) -> None:
        check_choice("kind", self.kind, KINDS)
        object.__setattr__(self, "text", " ".join(self.text.split()))
        if not self.text:
            raise ValueError(f"`text` of a band of kind {self.kind!r} must say where it comes from")


@dataclass(frozen=True)
class Band:
    """Range of values, ends included.

    - `low`, `high`: its ends; None where it is open, on one side at most.
    """

    low: float | None
    high: float | None
    origin: Origin

    def __post_init__(self) -> None:
        if self.low is None and self.high is None:
            raise ValueError("a band must have `low` or `high`, got neither")

    def holds(self, value: float | None) -> bool:
        """Whether a value lies in the band; False where there is none."""
        if value is None:
            return False
        above = self.low is None or self.low <= value
        return above and (self.high is None or value <= self.high)


@dataclass(frozen=True)
class Row:
    """One figure of a paper beside ours.

    - `table`: table or figure of the paper, such as ``"Table 4"``;
    - `row`: row of the table, such as ``"EWMA, experiment 1"``;
    - `quantity`: what is given, with its unit;
    - `paper`, `ours`: published and measured value; None where there is none.  What the paper
      claims in words of all or of none is a share of 1 or 0;
    - `band`: what the values are held against; None where nothing can be said;
    - `note`: why there is no band, why the paper cannot be met, or what else a reader should know.
    """

    table: str
    row: str
    quantity: str
    paper: float | None
    ours: float | None
    band: Band | None = None
    note: str = ""

    @property
    def printed_inside(self) -> bool | None:
        """Whether the printed value and ours both lie in the band; None where one is missing. A
        band that excludes the printed value is never met, wherever ours lies."""
        if self.paper is None or self.band is None:
            return None
        return self.band.holds(self.paper) and self.band.holds(self.ours)

    @property
    def agrees(self) -> bool | None:
        """Whether ours lies in the band of an independent implementation; None without one."""
        return self._inside("independent")

    @property
    def kept(self) -> bool | None:
        """Whether ours keeps a limit from theory or of our own; None without one."""
        return self._inside("bound")

    def _inside(self, kind: Kind) -> bool | None:
        if self.band is None or self.band.origin.kind != kind:
            return None
        return self.band.holds(self.ours)


def fill_origins(rows: Iterable[Row], **values: Any) -> list[Row]:
    """Rows whose origins of bands name the runs of this reproduction. `rows`: with texts that have
    ``{name}`` where a value belongs; `**values`: by name, such as the seed and numbers of runs."""

    def fill_origin(row: Row) -> Row:
        if row.band is None:
            return row
        origin = row.band.origin
        said = replace(origin, text=origin.text.format(**values))
        return replace(row, band=replace(row.band, origin=said))

    return [fill_origin(row) for row in rows]


class Paper(Protocol):
    """What a module of a paper has.

    - `TITLE`: authors and year, such as ``"Zhong et al. (2025)"``;
    - `CLAIMS`, `FINDINGS`, `READINGS`: Markdown, what the paper claims, what we found, and the
      readings that we took.
    """

    TITLE: str
    CLAIMS: str
    FINDINGS: str
    READINGS: str

    def parts(self, settings: Settings) -> list[Part]:
        """Work of a run."""

    def rows(self, data: dict[str, dict[str, Any]], settings: Settings) -> list[Row]:
        """Figures of the paper beside ours."""

    def figures(self, data: dict[str, dict[str, Any]], folder: Path) -> list[Path]:
        """Redraw the paper's figures from our runs."""
