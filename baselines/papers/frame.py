"""What a reproduction of a paper is made of: parts that run, and rows that compare.

A module ``baselines.papers.<key>`` names its parts, each a function with its settings that runs in
a process of its own.  From what all parts return it makes rows, one per published figure, with the
paper's value, ours and the band in which ours should lie.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes
    ----------
    quick : bool
        Whether to do with few runs: about a minute instead of ten.
    seed : int
        All chance follows from this number.
    """

    quick: bool
    seed: int


@dataclass(frozen=True)
class Part:
    """One unit of work, stored when it is done.

    Attributes
    ----------
    name : str
        Unique within the paper.
    function : callable
        Of a module, so that another process finds it; returns a dict of numbers, lists or arrays.
    settings : dict
        Its keyword arguments, as JSON has them, the seed among them.
    weight : float
        Relative duration, for the progress bar.
    """

    name: str
    function: Callable[..., dict[str, Any]]
    settings: dict[str, Any] = field(default_factory=dict)
    weight: float = 1.0


@dataclass(frozen=True)
class Row:
    """One figure of a paper beside ours.

    Attributes
    ----------
    table : str
        Table or figure of the paper, such as ``"Table 4"``.
    row : str
        Row of the table, such as ``"EWMA, experiment 1"``.
    quantity : str
        What is told, with its unit.
    paper, ours : float or None
        Published and measured value; None where there is none.
    low, high : float or None
        Band in which ours should lie, ends included; None where there is none.
    note : str
        Why the paper cannot be met, or where the band comes from.
    """

    table: str
    row: str
    quantity: str
    paper: float | None
    ours: float | None
    low: float | None
    high: float | None
    note: str = ""

    @property
    def inside(self) -> bool | None:
        """Whether ours lies in the band; None where there is no band."""
        if self.low is None and self.high is None:
            return None
        if self.ours is None:
            return False
        above = self.low is None or self.low <= self.ours
        return above and (self.high is None or self.ours <= self.high)


class Paper(Protocol):
    """What a module of a paper has.

    Attributes
    ----------
    TITLE : str
        Authors and year, such as ``"Zhong et al. (2025)"``.
    CLAIMS, FOUND, READINGS : str
        Markdown: what the paper claims, what we found, and the readings that we took.
    """

    TITLE: str
    CLAIMS: str
    FOUND: str
    READINGS: str

    def parts(self, settings: Settings) -> list[Part]:
        """Work of a run.

        Parameters
        ----------
        settings : Settings
            Of the run.

        Returns
        -------
        list of Part
            In the order in which they begin.
        """

    def rows(self, data: dict[str, dict[str, Any]], settings: Settings) -> list[Row]:
        """Figures of the paper beside ours.

        Parameters
        ----------
        data : dict
            What each part returned, by its name.
        settings : Settings
            Of the run.

        Returns
        -------
        list of Row
            In the order of the tables.
        """

    def figures(self, data: dict[str, dict[str, Any]], folder: Path) -> list[Path]:
        """Redraw the paper's figures from our runs.

        Parameters
        ----------
        data : dict
            What each part returned, by its name.
        folder : Path
            Where the pictures go.

        Returns
        -------
        list of Path
            PNG files.
        """
