"""The attacks of the tightly coupled papers, ready to be made.

They add an offset to pseudoranges alone, of one satellite or of several, from the onset on, and end
at once.  `make_attack` takes what `PaperAttack.attack` returns, `make_spoofer` its `spoofer`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

RATE_LIMIT_MPS = 250.0
"""Fast enough for the largest offset, 105 m, to come or go within one epoch of 0.5 s."""


@dataclass(frozen=True, kw_only=True)
class PaperAttack:
    """One attack of a paper.

    - `paper`: key in references.bib;
    - `onset_s`: when it begins in the paper's flight: the warm-up;
    - `duration_s`: how long it lasts, pauses counted;
    - `satellites`: how many are spoofed;
    - `spoofer`: as `make_spoofer` takes it.
    """

    paper: str
    onset_s: float
    duration_s: float
    satellites: int
    spoofer: dict[str, Any]

    def attack(self, channels: Sequence[str]) -> dict[str, Any]:
        """Attack of some satellites; the papers do not say where in the sky theirs are."""
        if len(channels) != self.satellites:
            raise ValueError(
                f"`channels` must name {self.satellites} satellite(s), got {tuple(channels)}"
            )
        return {
            "name": "per-channel",
            "control": "rate",
            "rate_limit_mps": RATE_LIMIT_MPS,
            "coherent": False,
            "channels": list(channels),
        }


def _bursts(
    shapes: Sequence[str], sizes_m: Sequence[float], on_s: float, off_s: float = 0.0
) -> dict[str, Any]:
    return {
        "name": "intermittent",
        "shapes": list(shapes),
        "sizes_m": list(sizes_m),
        "on_s": on_s,
        "off_s": off_s,
        "bursts": len(shapes),
    }


def _one(paper: str, shape: str, size_m: float, satellites: int = 1) -> PaperAttack:
    onset_s, duration_s = {"zhong2025": (200.0, 150.0), "ke2022": (350.0, 200.0)}[paper]
    return PaperAttack(
        paper=paper,
        onset_s=onset_s,
        duration_s=duration_s,
        satellites=satellites,
        spoofer=_bursts([shape], [size_m], duration_s),
    )


def _attacks() -> dict[str, PaperAttack]:
    found = {}
    for size in (15.0, 25.0, 35.0):
        found[f"zhong2025-step-{size:g}m"] = _one("zhong2025", "step", size)
    for rate in (0.2, 0.5, 0.7):
        found[f"zhong2025-ramp-{rate:g}mps"] = _one("zhong2025", "ramp", 150.0 * rate)
    found["zhong2025-intermittent"] = PaperAttack(
        paper="zhong2025",
        onset_s=200.0,
        duration_s=150.0,
        satellites=1,
        spoofer=_bursts(["ramp", "step"], [0.5 * 70.0, 25.0], 70.0, 10.0),
    )
    for size in (40.0, 30.0, 20.0, 10.0, 5.0):
        found[f"ke2022-step-{size:g}m"] = _one("ke2022", "step", size)
    for rate in (0.4, 0.3, 0.2, 0.1, 0.05):
        found[f"ke2022-ramp-{rate:g}mps"] = _one("ke2022", "ramp", 200.0 * rate)
    found["ke2022-three-step-30m"] = _one("ke2022", "step", 30.0, 3)
    found["ke2022-three-ramp-0.3mps"] = _one("ke2022", "ramp", 200.0 * 0.3, 3)
    return found


PAPER_ATTACKS: dict[str, PaperAttack] = _attacks()
"""Attacks by paper, shape and size."""
