"""Options that tools have in common that score spoofers."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from spoofgym.bench.experiments.evaluate import RUNS


def parser_of(text: str, out: Path | None = None, *, seed: int) -> argparse.ArgumentParser:
    """Options of a tool with a module's text, whose results are kept in `out` by default."""
    parser = argparse.ArgumentParser(description=text.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=RUNS, help="evaluation runs")
    parser.add_argument("--seed", type=int, default=seed, help="of all runs; trainings have 0")
    if out is not None:
        parser.add_argument("--out", type=Path, default=out)
        parser.add_argument("--fit-runs", type=int, default=128, help="training runs")
        parser.add_argument("--threads", type=int)
        parser.add_argument("--json", action="store_true")
    return parser


def sizes_of(given: argparse.Namespace) -> dict[str, Any]:
    return {
        "runs": given.runs,
        "fit_runs": given.fit_runs,
        "entropy": given.seed,
        "threads": given.threads,
    }
