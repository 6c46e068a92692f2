"""What all pictures share: matplotlib on demand, colours, the look of axes."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from .files import whole_file
from .registry import check_choice

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which colour-blind people can distinguish, and two more
COLOURS = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#E69F00",
    "#56B4E9",
    "#000000",
    "#882255",
    "#999933",
)
BLUE, ORANGE, GREEN = COLOURS[:3]  # the clean twin, what is attacked, what is commanded
RED = "#B2182B"  # alarms
GREY = "#777777"
GRID = "#dddddd"


def figure_class() -> type[Figure]:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ImportError(
            "pictures need matplotlib: pip install 'spoofgym[report]', or '.[report]' in a checkout"
        ) from error
    return Figure


def check_picture(path: Path, others: Iterable[str] = ()) -> Path:
    """Path with an ending; a ValueError for one that no figure has, nor `others`."""
    path = path if path.suffix else path.with_suffix(".png")
    formats = figure_class()().canvas.get_supported_filetypes()
    endings = [*(f".{each}" for each in formats), *others]
    check_choice("ending of a picture", path.suffix.lower(), endings)
    return path


def save_figure(figure: Figure, path: Path, dpi: float | Literal["figure"] = "figure") -> Path:
    path = check_picture(path)
    with whole_file(path) as part:
        figure.savefig(part, format=path.suffix[1:], dpi=dpi)
    return path


def style(ax: Axes) -> None:
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(True, color=GRID, lw=0.6)
    ax.set_axisbelow(True)
