"""Rows of tables 2 to 8, ours averaged over the skies.

Bands of averages are those of a second program; bands of single rows lie around the paper's figure.
A rate that is 100 % less the others has a row and no band, so that nothing is counted twice.
"""

from __future__ import annotations

from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..frame import Band, Origin, Row
from . import published
from .geometry import SATELLITES
from .origins import (
    AVERAGES,
    CLOCK,
    SEARCH_FITS,
    SEARCH_RATES,
    SEEDS,
    TIME,
    TRAVERSAL_FITS,
    TRAVERSAL_RATES,
)
from .origins import HYBRIDS as HYBRIDS_BAND
from .partitions import METHODS

FloatArray = NDArray[np.float64]
Data = dict[str, dict[str, Any]]

COUNTS = range(1, SATELLITES)
WEIGHT = np.array([comb(SATELLITES, k) for k in COUNTS]) / (2**SATELLITES - 2)
"""Part of the 4094 subsets with 1 to 11 spoofed satellites."""
NAMES = {"srv": "SRV-RAIM", "traversal": "traversal RAIM"}
LAST = 4
"""Place of the last of `HYBRIDS`."""
HYBRIDS = ("0", "2", "3", "4", "5 or more")
KINDS = ("success", "false", "fail")

CLOCK_NOTE = (
    "not met: the paper's share of 2 to 4 hybrids is larger; it depends on the clock's part of the "
    "displacement, which is not printed, and on the sky"
)
REST = "no band: 100 % less the others"


def stack_skies(data: Data, part: str, name: str) -> FloatArray:
    """Results of all skies. Returns (skies, 11, columns)."""
    return np.array([np.asarray(d[name]) for key, d in data.items() if key.startswith(part)])


def mean(values: FloatArray) -> float:
    """Mean over all subsets of (11,) values by number of spoofed satellites."""
    return float(WEIGHT @ values)


def pool_fits(rates: FloatArray) -> float:
    """Mean number of fits of all cases that did not fail. `rates`: (11, 4 or more) success, false,
    fail and fits by number of spoofed satellites."""
    weight = WEIGHT * (1.0 - rates[:, 2])
    return float(weight @ rates[:, 3] / weight.sum())


def around(value: float, margin: float, origin: Origin) -> Band:
    """Band around a value, not below 0."""
    return Band(round(max(value - margin, 0.0), 6), round(value + margin, 6), origin)


def name_row(count: int) -> str:
    """Name of a row."""
    return f"{count} spoofed"


def separation_rows(data: Data) -> list[Row]:
    """Tables 2, 3 and 4."""
    least = 100.0 * stack_skies(data, "separation", "hybrids").mean(axis=0)
    clock = 100.0 * stack_skies(data, "separation", "hybrids_clock").mean(axis=0)
    seeded = 100.0 * stack_skies(data, "separation", "seeded").mean(axis=0)
    rows = []
    for k in COUNTS:
        for j, paper in enumerate(published.SEPARATED[k]):
            band = None if j == LAST else around(paper, 2.0 if j else 5.0, HYBRIDS_BAND)
            quantity, note = f"NH0 = {HYBRIDS[j]} [%]", REST if j == LAST else ""
            ours = least[k - 1, j]
            rows.append(Row("Table 2", name_row(k), quantity, paper, ours, band, note))
    for j, paper in enumerate(published.SEPARATED_AVERAGE):
        band = around(paper, 2.0, HYBRIDS_BAND) if j else Band(76.5, 84.5, AVERAGES)
        quantity, note = f"NH0 = {HYBRIDS[j]} [%]", ""
        if j == LAST:
            band, note = None, REST
        rows.append(Row("Table 2", "average", quantity, paper, mean(least[:, j]), band, note))
    for j, paper in enumerate(published.CLOCK_AVERAGE):
        band = around(paper, 2.0, CLOCK) if j else Band(28.0, 48.0, AVERAGES)
        quantity, note = f"NH(e4) = {HYBRIDS[j]} [%]", CLOCK_NOTE if j else ""
        if j == LAST:
            band, note = None, f"{REST}, which are not all met"
        rows.append(Row("Table 3", "average", quantity, paper, mean(clock[:, j]), band, note))
    for k in COUNTS:
        for j, paper in enumerate(published.SEEDED[k]):
            band, ours = around(paper, (1.5, 4.0, 3.5, 3.0)[j], SEEDS), seeded[k - 1, j]
            rows.append(Row("Table 4", name_row(k), f"p(H0; S{j}) [%]", paper, ours, band))
    middles = ((98.4, 1.0), (92.0, 3.5), (95.9, 2.0), (97.6, 1.3))
    for j, paper in enumerate(published.SEEDED_AVERAGE):
        band, ours = around(*middles[j], AVERAGES), mean(seeded[:, j])
        rows.append(Row("Table 4", "average", f"p(H0; S{j}) [%]", paper, ours, band))
    return rows


RATE_TABLES = {"srv": ("Table 5", "Table 6"), "traversal": ("Table 7", "Table 8")}
MARGINS = {"srv": (3.0, 5.0), "traversal": (1.5, 1.5)}
"""Half of the width of a row's band [points], and that of 1 and 11 spoofed satellites."""
RATE_BANDS = {
    "srv": ((87.3, 1.5), (3.2, 1.0), (9.5, 1.6)),
    "traversal": ((90.1, 0.8), (2.85, 0.6), (7.05, 0.6)),
}
FIT_BANDS = {"srv": (20.0, 25.5), "traversal": (1352.0, 1372.0)}
TIME_LIMIT_US = {"srv": 8.0, "traversal": 80.0}


def rate_rows(method: str, rates: FloatArray) -> list[Row]:
    """Table 5 or 7. `method`: ``srv``, ``traversal``: which search; `rates`: (11, 5) means over the
    skies."""
    table, _ = RATE_TABLES[method]
    rows = []
    origin = SEARCH_RATES if method == "srv" else TRAVERSAL_RATES
    for k in COUNTS:
        margin = MARGINS[method][k in (1, SATELLITES - 1)]
        for j, paper in enumerate(published.RATES[method][k]):
            rest = KINDS[j] == "fail"
            band, note = None if rest else around(paper, margin, origin), REST if rest else ""
            ours = 100.0 * rates[k - 1, j]
            rows.append(Row(table, name_row(k), f"{KINDS[j]} [%]", paper, ours, band, note))
    for j, paper in enumerate(published.RATES_AVERAGE[method]):
        rest = KINDS[j] == "fail"
        band = None if rest else around(*RATE_BANDS[method][j], AVERAGES)
        ours, note = 100.0 * mean(rates[:, j]), REST if rest else ""
        rows.append(Row(table, "average", f"{KINDS[j]} [%]", paper, ours, band, note))
    return rows


def fit_rows(method: str, rates: FloatArray) -> list[Row]:
    """Table 6 or 8. `method`: ``srv``, ``traversal``: which search; `rates`: (11, 5) means over the
    skies."""
    _, table = RATE_TABLES[method]
    rows = []
    for k in COUNTS:
        paper = published.POSITIONINGS[method][k - 1]
        margin, origin = 3.0, SEARCH_FITS
        if method == "traversal":
            edge = k in (1, SATELLITES - 1)
            margin, origin = 1.0 if edge else 0.02 * paper, TRAVERSAL_FITS
        ours, band = float(rates[k - 1, 3]), around(paper, margin, origin)
        rows.append(Row(table, name_row(k), "mean n_s", paper, ours, band))
    paper, ours = published.POSITIONINGS_AVERAGE[method], pool_fits(rates)
    band = Band(*FIT_BANDS[method], AVERAGES)
    rows.append(Row(table, "average", "mean n_s", paper, ours, band))
    return rows


def partition_rows(data: Data) -> list[Row]:
    """Tables 5 to 8, and the time of a call."""
    rates = {m: stack_skies(data, "partitions", m).mean(axis=0) for m in METHODS}
    rows = [row for m in METHODS for row in (*rate_rows(m, rates[m]), *fit_rows(m, rates[m]))]
    ratio = 100.0 * pool_fits(rates["srv"]) / pool_fits(rates["traversal"])
    what, note = "n_s, SRV over traversal [%]", "no band: it follows from the two averages"
    rows.append(Row("Table 8", "average", what, 1.7, ratio, note=note))
    for m in METHODS:
        ours = float(WEIGHT @ stack_skies(data, "partitions", m)[:, :, 4].min(axis=0))
        quantity, band = "time of a call [us]", Band(None, TIME_LIMIT_US[m], TIME)
        rows.append(Row("Speed", NAMES[m], quantity, None, ours, band, "not in the paper"))
    return rows
