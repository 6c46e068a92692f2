"""The protection of a detector: how far the worst attacks of the suite come, in every run.

Scores and their paired differences between detectors follow from that.
`spoofgym.bench.attack_search` looks for these attacks.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .scores import exceeded

FloatArray = NDArray[np.float64]
MEASURES = (
    "undetected_displacement_m",
    "undetected_vertical_m",
    "undetected_total_m",
    "undetected_total_vertical_m",
)
"""Induced and total error, horizontal and vertical; a victim in the plane has no vertical ones."""


class Aim(NamedTuple):
    """What an attack is chosen by.

    - `measure`: one of `MEASURES`;
    - `share`: of the runs in which the displacement is to be large; or
    - `limit_m`: alert limit that is to be exceeded often;
    - `skies`: whether only the worst tenth of them counts.
    """

    measure: str
    share: float | None = None
    limit_m: float | None = None
    skies: bool = False

    def reached(self, displacement: FloatArray) -> float:
        """What is exceeded in the share of the runs that count, or how often the limit is."""
        if not len(displacement):
            return 0.0
        if self.share is not None:
            return exceeded(displacement, self.share)
        assert self.limit_m is not None  # one of the two is given
        return float((displacement > self.limit_m).mean())

    def worth(self, displacement: FloatArray) -> float:
        """How good a displacement of the runs that count is, to choose by. Of attacks that exceed a
        limit equally often, that whose weakest such run is the farthest above it, as it will most
        surely do so again; of those that never do, that which comes nearest."""
        reached = self.reached(displacement)
        if self.limit_m is None or not len(displacement):
            return reached
        weakest = self.weakest(displacement)
        return reached + 1e-9 * weakest / (1.0 + weakest)

    def weakest(self, displacement: FloatArray) -> float:
        """Smallest displacement beyond the limit, or, where none is, the largest [m]."""
        above = displacement > (self.limit_m or 0.0)
        return float(displacement[above].min() if above.any() else displacement.max(initial=0.0))


@dataclass(frozen=True)
class Winner:
    """An attack that is the worst one for some aims.

    - `letter`, `spoofer`, `setting`, `value`, `spec`: which one;
    - `aims`: for what;
    - `displacement` by measure (R,) of the evaluation runs [m].
    """

    letter: str
    spoofer: str
    setting: str
    value: float
    spec: dict[str, Any]
    aims: tuple[Aim, ...]
    displacement: dict[str, FloatArray]


@dataclass(frozen=True)
class Protection:
    """What the suite achieves against one detector.

    - `head`: detector, suite, selection and campaign, JSON-able;
    - `winners`: the worst attacks on the evaluation runs;
    - `counts`, `sky` (R,) which of these runs count, and under which sky;
    - `skies`: the worst tenth; None where there are too few.
    """

    head: dict[str, Any]
    winners: tuple[Winner, ...]
    counts: NDArray[np.bool_]
    sky: NDArray[np.int64]
    skies: NDArray[np.int64] | None

    @property
    def detector(self) -> str:
        return str(self.head["detector"])

    def winner(self, aim: Aim) -> Winner | None:
        """Who is the worst for an aim; None where nobody was looked for."""
        return next((each for each in self.winners if aim in each.aims), None)

    def worst(self, aim: Aim) -> Winner:
        """Worst attack on the evaluation runs; of equal ones that which was chosen for the aim."""
        chosen, rows = self.winner(aim), self.rows(aim)
        several = (*([] if chosen is None else [chosen]), *self.winners)
        return max(several, key=lambda each: aim.reached(each.displacement[aim.measure][rows]))

    def rows(self, aim: Aim) -> NDArray[np.bool_]:
        """(R,) which runs an aim is about."""
        if not aim.skies or self.skies is None:
            return self.counts
        return self.counts & np.isin(self.sky, self.skies)

    def to_text(self) -> str:
        winners = [
            {
                **{name: getattr(each, name) for name in ("letter", "spoofer", "setting", "value")},
                "spec": each.spec,
                "aims": [aim._asdict() for aim in each.aims],
                "displacement": {name: x.tolist() for name, x in each.displacement.items()},
            }
            for each in self.winners
        ]
        skies = None if self.skies is None else self.skies.tolist()
        runs = {"counts": self.counts.tolist(), "sky": self.sky.tolist(), "skies": skies}
        return json.dumps({**self.head, **runs, "winners": winners}, allow_nan=False) + "\n"

    @classmethod
    def from_text(cls, text: str) -> Protection:
        """Inverse of `to_text`."""
        head = json.loads(text)
        runs = {name: head.pop(name) for name in ("counts", "sky", "skies", "winners")}
        winners = tuple(
            Winner(
                **{
                    **each,
                    "aims": tuple(Aim(**aim) for aim in each["aims"]),
                    "displacement": {k: np.array(x) for k, x in each["displacement"].items()},
                }
            )
            for each in runs["winners"]
        )
        skies = None if runs["skies"] is None else np.array(runs["skies"])
        counts = np.array(runs["counts"], dtype=np.bool_)
        return cls(head, winners, counts, np.array(runs["sky"]), skies)
