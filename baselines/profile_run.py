"""One search from the ramps to the choice, which goes on where it was interrupted."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.scores.statistics import aim
from spoofgym.bench.search.amplitude import TuningResult, tune
from spoofgym.core.files import write_file
from spoofgym.core.settings import differences
from spoofgym.spoofers.card import NAME, Card

from .profile_choice import Choice, choose
from .profile_search import ProfileSearch
from .profile_settings import Generation, SearchSettings, Start
from .profile_start import best_start, resampled, start_between
from .runs import RunPool

Tell = Callable[[float, str], None]
DEFAULT_SECONDS = 120.0


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """A search and its choice.

    - `select_runs`: other training runs, of the choice and of the ramps.
    """

    search: SearchSettings
    runs: int = 128
    select_runs: int = 512

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.runs < self.search.batch:
            raise ValueError(
                f"`runs` must be at least `batch` = {self.search.batch}, got {self.runs}"
            )
        if self.select_runs < 2:
            raise ValueError(f"`select_runs` must be at least 2, got {self.select_runs}")


@dataclass(frozen=True)
class Bounds:
    """When a search ends.

    - `seconds`: time, interruptions not counted, above 0.
    """

    seconds: float | None
    generations: int | None

    def __post_init__(self) -> None:
        """Check them."""
        if self.seconds is not None and not 0.0 < self.seconds < float("inf"):
            raise ValueError(f"`seconds` must be finite and > 0, got {self.seconds}")
        if self.generations is not None and self.generations < 1:
            raise ValueError(f"`generations` must be at least 1, got {self.generations}")

    @classmethod
    def of(cls, seconds: float | None, generations: int | None) -> Bounds:
        """Bounds of which at least one is set. `seconds`: time; 120 s where nothing is said at
        all."""
        neither = seconds is None and generations is None
        return cls(DEFAULT_SECONDS if neither else seconds, generations)

    def done(self, elapsed_s: float, generations: int) -> float:
        """Part of the search that is behind; one generation is played at least."""
        if generations == 0:
            return 0.0
        parts = [
            spent / bound
            for spent, bound in ((elapsed_s, self.seconds), (generations, self.generations))
            if bound is not None
        ]
        return max(parts)


class ProfileRun:
    """A search, with a record beside its result.

    - `suite`: world, attack, one detector, two ramps to be tuned, seeds and tuning;
    - `out`: where the card will be;
    - `start`: card of a profile to begin at;
    - `resume`: whether to go on with the record that is there.  If not, record and card are
      replaced;
    - `out`, `path`: where the card will be, and the record of the search beside it;
    - `ramps`: tuned ramps, once they are;
    - `elapsed_s`: time of the search, interruptions not counted.
    """

    def __init__(
        self,
        suite: Suite,
        settings: RunSettings,
        out: Path,
        *,
        start: Path | None = None,
        threads: int | None = None,
        resume: bool = True,
    ) -> None:
        if out.suffix != ".json":
            raise ValueError(f"`out` must be a .json file, got {out}")
        if not re.fullmatch(NAME, out.stem):
            raise ValueError(
                "`out` names the profile, so that it must begin with a letter or a digit, and have "
                f"only letters, digits, '.', '_' and '-', got {out.name!r}"
            )
        if resume and out.exists():
            raise ValueError(f"{out} exists; --overwrite replaces it, or choose another --out")
        self.suite, self.settings, self.threads = suite, settings, threads
        self.out, self.path = out, out.with_suffix(".search.json")
        self.detector = suite.detector_entries[0]
        self.setup = suite.setup(self.detector)
        self.budget = settings.search.budget
        self._given = None if start is None else _rates_of(start, settings.search.knots)
        self.ramps: list[TuningResult] = []
        self.start: Start | None = None
        self.generations: list[Generation] = []
        self.elapsed_s = 0.0
        if resume and self.path.exists():
            self._load()

    @property
    def config(self) -> dict[str, Any]:
        """All that the search depends on, but for its bounds."""
        return {**self.suite.config, "search": asdict(self.settings), "start": self._given}

    @property
    def aim(self) -> float:
        """Alarm rate that the search aims at; known once the ramps are tuned."""
        return aim(min(ramp.counted for ramp in self.ramps), self.budget)

    def _load(self) -> None:
        """Take up the record of an interrupted search."""
        try:
            found = json.loads(self.path.read_text(encoding="utf-8"))
            config = found["config"]
            ramps = [TuningResult.from_dict(item) for item in found["ramps"]]
            start = None if found["start"] is None else Start(**found["start"])
            generations = [Generation(**item) for item in found["generations"]]
            elapsed = float(found["elapsed_s"])
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(
                f"{self.path} is no record of a search ({error}); --overwrite replaces it"
            ) from error
        changed = differences(config, json.loads(json.dumps(self.config)))
        if changed:
            raise ValueError(
                f"{self.path} is the record of another search (different: "
                f"{', '.join(name for name, _, _ in changed)}); "
                "--overwrite replaces it, or choose another --out"
            )
        self.ramps, self.start = ramps, start
        self.generations, self.elapsed_s = generations, elapsed

    def _save(self) -> None:
        """Write the record as a whole."""
        content = {
            "config": self.config,
            "ramps": [ramp.as_dict() for ramp in self.ramps],
            "start": None if self.start is None else asdict(self.start),
            "elapsed_s": self.elapsed_s,
            "generations": [asdict(generation) for generation in self.generations],
        }
        write_file(self.path, json.dumps(content, allow_nan=False).encode())

    def play(self, bounds: Bounds, tell: Tell) -> Choice:
        """Tune the ramps, search, and choose; what the record holds is not done again. `tell`: told
        the part of the search that is done, and what is going on."""
        tell(0.0, "warm-up")
        select, runs = self.settings.select_runs, self.settings.runs
        rngs = self.suite.generators("training", select + runs)
        chosen = RunPool(self.setup, rngs[:select], threads=self.threads)
        pool = RunPool(self.setup, rngs[select:], threads=self.threads)
        self._tune(chosen, tell)
        search = self._search(pool, bounds, tell)
        tell(1.0, "choosing")
        return choose(search, chosen, self.budget)

    def _tune(self, chosen: RunPool, tell: Tell) -> None:
        """Tune the ramps."""
        entries = [entry for entry in self.suite.spoofer_entries if entry.tuned]
        for entry in entries[len(self.ramps) :]:
            tell(0.0, f"tuning {entry.label}")
            label, tuning = self.detector.label, self.suite.tuning
            self.ramps.append(tune(chosen.start, chosen.clean, entry, label, tuning))
            self._save()

    def _search(self, pool: RunPool, bounds: Bounds, tell: Tell) -> ProfileSearch:
        """Search until a bound is reached."""
        begun = time.monotonic() - self.elapsed_s
        settings = replace(self.settings.search, budget=self.aim)
        if self.start is None:
            tell(0.0, "where to begin")
            values = {ramp.setting: ramp.value for ramp in self.ramps}
            self.start = (
                start_between(pool, settings, values["rate_mps"], values["acceleration_mps2"])
                if self._given is None
                else best_start(pool, settings, [np.asarray(self._given)])
            )
            self.elapsed_s = time.monotonic() - begun
            self._save()
        search = ProfileSearch(pool, settings, self.start, self.generations)
        while not search.finished:
            part = bounds.done(self.elapsed_s, len(search.generations))
            if part >= 1.0:
                break
            tell(part, _now(search))
            search.step()
            self.generations = search.generations
            self.elapsed_s = time.monotonic() - begun
            self._save()
        return search


def _now(search: ProfileSearch) -> str:
    """State of a search in a few words."""
    if not search.generations:
        return "first generation"
    last = search.generations[-1]
    return (
        f"generation {len(search.generations)}: {last.displacement_m:.1f} m, "
        f"{100 * last.alarm_rate:.1f} % alarms"
    )


def _rates_of(path: Path, knots: int) -> list[float]:
    """Rates of the profile of a card, by as many knots as are wanted."""
    card = Card.load(path)
    if card.kind != "profile":
        raise ValueError(f"{path} must be the card of a profile, got that of an {card.kind}")
    return resampled(card.settings["rates_mps"], knots)
