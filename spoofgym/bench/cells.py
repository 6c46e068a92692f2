"""What is kept of a cell: one record for every run, and the course of time over all of them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..simulators.setup import Setup
from .metrics import undetected_displacement
from .run import Runs, induced_error, navigation_error

FloatArray = NDArray[np.float64]
PERCENTILES = (5, 50, 95)
_NUMBERS = (
    "undetected_displacement_m",
    "largest_error_m",
    "final_error_m",
    "navigation_rms_m",
    "peak_ratio",
)


@dataclass(frozen=True)
class Cell:
    """All runs of a detector and a spoofer.

    - `head`: labels, settings and lengths, JSON-able;
    - `records` (R,) arrays: ``warmup_alarm`` bool; ``first_alarm`` epoch from 1 on, 0 for none;
      ``alarm_epochs`` how many; ``undetected_displacement_m``; ``largest_error_m`` and
      ``final_error_m`` of the command phase, alarmed or not; ``navigation_rms_m`` distance from the
      truth; ``peak_ratio`` of statistic to threshold;
    - `series`: by epoch: ``time_s`` since the onset, ``alarmed`` part of the runs, ``error_m``
      percentiles over all runs.
    """

    head: dict[str, Any]
    records: dict[str, NDArray[Any]]
    series: dict[str, Any]

    @property
    def detector(self) -> str:
        """Label of the detector."""
        return str(self.head["detector"])

    @property
    def spoofer(self) -> str:
        """Label of the spoofer."""
        return str(self.head["spoofer"])

    @property
    def runs(self) -> int:
        """R."""
        return len(self.records["first_alarm"])

    @property
    def window(self) -> int:
        """Epochs from the onset to the end of the hold, K."""
        return int(self.head["steps"]) + int(self.head["hold"])

    @property
    def interval_s(self) -> float:
        """Time between epochs."""
        return float(self.head["interval_s"])

    @property
    def alarmed(self) -> NDArray[np.bool_]:
        """(R,) whether there was an alarm in the window."""
        return np.asarray(self.records["first_alarm"] > 0)

    def to_lines(self) -> list[str]:
        """JSON lines: head, runs, series."""
        records = [
            {"kind": "run", "run": run, **{key: x[run].item() for key, x in self.records.items()}}
            for run in range(self.runs)
        ]
        parts = [{"kind": "cell", **self.head}, *records, {"kind": "series", **self.series}]
        return [json.dumps(part, allow_nan=False) for part in parts]

    @classmethod
    def from_lines(cls, lines: list[str]) -> Cell:
        """Inverse of `to_lines`."""
        parts = [json.loads(line) for line in lines]
        kinds = [part.pop("kind") for part in parts]
        if kinds[:1] != ["cell"] or kinds[-1:] != ["series"] or {*kinds[1:-1]} != {"run"}:
            raise ValueError("a cell must be one line `cell`, lines `run`, and one line `series`")
        runs = parts[1:-1]
        records = {key: np.array([run[key] for run in runs]) for key in runs[0] if key != "run"}
        return cls(parts[0], records, parts[-1])


def make_cell(
    setup: Setup,
    head: dict[str, Any],
    warmup_alarm: NDArray[np.bool_],
    attacked: Runs,
    twin: Runs,
) -> Cell:
    """Score the runs of a cell.  `warmup_alarm` (R,) bool, alarms before the onset."""
    interval = setup.interval_s
    error = induced_error(setup, attacked, twin)
    commanded = error[: setup.steps]
    off = navigation_error(setup, attacked)
    first = attacked.first_alarm
    numbers = (
        undetected_displacement(commanded, first, setup.hold),
        commanded.max(axis=0),
        commanded[-1],
        np.sqrt((off * off).mean(axis=0)),
        attacked.peak,
    )
    records: dict[str, NDArray[Any]] = {
        "warmup_alarm": warmup_alarm,
        "first_alarm": first,
        "alarm_epochs": attacked.alarm.sum(axis=0),
    }
    records |= {name: np.round(x, 6) for name, x in zip(_NUMBERS, numbers, strict=True)}
    epochs = np.arange(1, len(error) + 1)
    bands = np.percentile(error, PERCENTILES, axis=1)
    series = {
        "time_s": (epochs * interval).round(6).tolist(),
        "alarmed": ((first > 0) & (first <= epochs[:, None])).mean(axis=1).round(6).tolist(),
        "error_m": {
            f"p{p:02d}": band.round(4).tolist() for p, band in zip(PERCENTILES, bands, strict=True)
        },
    }
    lengths = {"interval_s": interval, "steps": setup.steps, "hold": setup.hold}
    return Cell({**head, **lengths}, records, series)
