"""Wu et al. (2024): SRV-RAIM beside traversal RAIM, tables 2 to 8 and figures 1 and 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..frame import Part, Row, Settings, fill_origins
from .figures import draw_figures, run_pictures
from .geometry import PLACES
from .partitions import run_partitions
from .separation import run_separation
from .tables import partition_rows, separation_rows

TITLE = "Wu et al. (2024)"

CLAIMS = """
Twelve satellites are in view, and any number of them is spoofed, all implying the same position and
clock.  Their residual vectors and those of the authentic satellites are separated by a plane in
80 % of the cases, while plain residuals are separated in 43 %.  SRV-RAIM, which searches 40
directions for five satellites that agree, tells the groups apart in 86.6 % of the cases with 23
position fixes; a search of all subsets does so in 90.1 % with 1361.
"""

FINDINGS = """
- Apart from table 3, these averages are reproduced: separation, how often a search set finds a seed
  (the five satellites that lie farthest along one direction are all spoofed, or all authentic; the
  search grows from them), success, false and failed rates, and numbers of fixes of both methods.
  Traversal RAIM is met row by row, and does not depend on the sky.
- SRV-RAIM as printed is not what was run: with one pass of growth its false separations with one
  spoofed satellite are nearly twice the paper's.  With passes until nothing is added, they agree.
- A hybrid is an authentic satellite that lies among the spoofed ones along the best direction, or a
  spoofed one among the authentic.  The share of cases without hybrids for plain residuals (table 3)
  is within its wide band, but 2 and 3 hybrids are rarer than printed, and 5 or more commoner: they
  depend on the clock's part of the displacement and on the sky, neither of which is printed.
- SRV-RAIM needs 60 times fewer fixes, but not 60 times less time: sorting and failed searches are
  not counted as fixes, so that a call takes about a tenth of the time.  With 1 or 11 spoofed
  satellites, traversal is the faster one.
- Every single test has a confidence of 95 %: both methods call 5 % of clean epochs inconsistent,
  and fail to tell 10 % of the cases with 5 to 7 spoofed satellites for that reason alone.
"""

READINGS = """
- The threshold's 95 % is the confidence of the chi-square test, not its alarm rate.
- The displacement is uniform in direction in four dimensions, clock included, and uniform in length
  from 100 m to 4 km; it is drawn again until every *spoofed* range is changed by more than 100 m.
- Every case has a displacement of its own, where the paper's 100 are shared by all subsets.
- Steps 12 to 19 of algorithm 1 are repeated until a pass adds nothing.
- Averages weigh the rows by their number of subsets; those of numbers of fixes are taken over all
  runs that did not fail.
- Numbers of hybrids along the clock's axis are the smaller of both signs.
- The geometry is linear, in ECEF axes; search vectors belong to axes, and local ones move the rates
  by up to a point.
- Traversal RAIM starts with nothing left out; both groups count as fixes where both are tested.
- The sky is ours: circular orbits at several places, and random ones.
"""

FULL, QUICK = (10_000, len(PLACES)), (3_000, 3)
"""Least number of cases for each number of spoofed satellites in a sky, and skies."""
PICTURES = 400
SHARED_DRAWS = 100
"""Displacements of one constellation in a quick picture, as in the paper."""


def parts(settings: Settings) -> list[Part]:
    """Work of a run."""
    draws, skies = QUICK if settings.quick else FULL
    work: list[Part] = []
    for number in range(skies):
        given = {"number": number, "draws": draws, "seed": settings.seed}
        work.append(Part(f"partitions {number}", run_partitions, given, weight=4.0))
        work.append(Part(f"separation {number}", run_separation, given, weight=2.0))
    pictured = {"draws": SHARED_DRAWS if settings.quick else PICTURES, "seed": settings.seed}
    work.append(Part("pictures", run_pictures, pictured, weight=0.5))
    return work


def rows(data: dict[str, dict[str, Any]], settings: Settings) -> list[Row]:
    """Figures of the paper beside ours."""
    draws, skies = QUICK if settings.quick else FULL
    made = separation_rows(data) + partition_rows(data)
    return fill_origins(made, draws=draws, skies=skies, seed=settings.seed)


def figures(data: dict[str, dict[str, Any]], folder: Path) -> list[Path]:
    """Redraw the paper's figures from our runs."""
    return draw_figures(data, folder)
