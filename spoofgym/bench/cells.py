"""What is kept of a cell: one record for every run, and the course of time over all of them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..simulators.setup import Setup
from .run import Runs, horizontal, induced, off_truth
from .scores import Stealth, counted, stealth_of, undetected_displacement

FloatArray = NDArray[np.float64]
PERCENTILES = (5, 50, 95)


@dataclass(frozen=True)
class Cell:
    """All runs of a detector and a spoofer.

    - `head`: labels, settings and lengths, JSON-able;
    - `records` (R,) arrays: ``warmup_alarm`` bool; ``first_alarm``, and ``twin_alarm`` of the clean
      twin, epoch from 1 on, 0 for none; ``alarm_epochs`` how many; ``crossing`` first epoch with
      the induced error above the alert limit, 0 for none; ``undetected_displacement_m``, the same
      ``undetected_vertical_m``, ``undetected_along_m`` the target direction, and of the total error
      ``undetected_total_m`` and ``undetected_total_vertical_m``, as far as there are these axes;
      ``largest_error_m`` and ``final_error_m`` of the command phase, alarmed or not;
      ``navigation_rms_m`` distance from the truth; ``coasting_epochs``, and ``coasting_error_m``
      the largest distance from the truth in them; ``blamed`` channels, summed over the epochs;
      ``sky`` which one it flew under; ``peak_ratio`` of statistic to threshold;
    - `series`: by epoch: ``time_s`` since the onset, ``alarmed`` part of the runs, ``error_m``
      percentiles over all runs.
    """

    head: dict[str, Any]
    records: dict[str, NDArray[Any]]
    series: dict[str, Any]

    @property
    def detector(self) -> str:
        return str(self.head["detector"])

    @property
    def spoofer(self) -> str:
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
    def counts(self) -> NDArray[np.bool_]:
        """(R,) which runs count for a score."""
        return counted(self.records["warmup_alarm"], self.records["twin_alarm"])

    @property
    def sky(self) -> NDArray[np.int64]:
        """(R,) under which sky each run flew."""
        return np.asarray(self.records["sky"])

    @property
    def displacement_m(self) -> FloatArray:
        """(R,) undetected displacement [m]."""
        return np.asarray(self.records["undetected_displacement_m"], dtype=np.float64)

    @property
    def stealth(self) -> Stealth:
        """Score of the spoofer."""
        return stealth_of(self.displacement_m, self.alarmed, self.counts)

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
    alert_limit_m: float,
) -> Cell:
    """Score the runs of a cell.  `warmup_alarm` (R,) bool, alarms before the onset."""
    moved, off = induced(setup, attacked, twin), off_truth(setup, attacked)
    error, total = horizontal(moved), horizontal(off)
    commanded, first = error[: setup.steps], attacked.first_alarm
    above = commanded > alert_limit_m

    def undetected(size: FloatArray) -> FloatArray:
        return undetected_displacement(size[: setup.steps], first, setup.hold)

    numbers = {
        "undetected_displacement_m": undetected(error),
        "undetected_total_m": undetected(total),
        "largest_error_m": commanded.max(axis=0),
        "final_error_m": commanded[-1],
        "navigation_rms_m": np.sqrt((total * total).mean(axis=0)),
        "coasting_error_m": np.where(attacked.coasting, total, 0.0).max(axis=0),
        "peak_ratio": attacked.peak,
    }
    if moved.shape[2] == 3:
        numbers["undetected_vertical_m"] = undetected(np.abs(moved[..., 2]))
        numbers["undetected_total_vertical_m"] = undetected(np.abs(off[..., 2]))
    if setup.target_heading_deg != "worst":
        north, east = np.cos(attacked.heading), np.sin(attacked.heading)
        numbers["undetected_along_m"] = undetected(moved[..., 0] * north + moved[..., 1] * east)
    records: dict[str, NDArray[Any]] = {
        "warmup_alarm": warmup_alarm,
        "first_alarm": first,
        "twin_alarm": twin.first_alarm,
        "alarm_epochs": attacked.alarm.sum(axis=0),
        "coasting_epochs": attacked.coasting.sum(axis=0),
        "blamed": attacked.blamed,
        "crossing": np.where(above.any(axis=0), above.argmax(axis=0) + 1, 0),
        "sky": attacked.onset // setup.epochs_each,
    }
    records |= {name: np.round(x, 6) for name, x in numbers.items()}
    epochs = np.arange(1, len(error) + 1)
    bands = np.percentile(error, PERCENTILES, axis=1)
    series = {
        "time_s": (epochs * setup.interval_s).round(6).tolist(),
        "alarmed": ((first > 0) & (first <= epochs[:, None])).mean(axis=1).round(6).tolist(),
        "error_m": {
            f"p{p:02d}": band.round(4).tolist() for p, band in zip(PERCENTILES, bands, strict=True)
        },
    }
    lengths = {"interval_s": setup.interval_s, "steps": setup.steps, "hold": setup.hold}
    by_channel = setup.detector.scope == "channel"
    return Cell({**head, **lengths, "judges_channels": by_channel}, records, series)
