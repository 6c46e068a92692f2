"""Options that tools have in common that score spoofers."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from spoofgym.bench.experiments.evaluate import RUNS


def make_parser(text: str, out: str, fit_runs: int = 128) -> argparse.ArgumentParser:
    """Options of a tool with a module's text, whose results are kept in `out` by default."""
    parser = argparse.ArgumentParser(description=text.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path(out))
    parser.add_argument("--runs", type=int, default=RUNS, help="evaluation runs")
    parser.add_argument("--fit-runs", type=int, default=fit_runs, help="training runs")
    parser.add_argument("--threads", type=int)
    parser.add_argument("--json", action="store_true")
    return parser


def get_sizes(given: argparse.Namespace, entropy: int) -> dict[str, Any]:
    own = {name: getattr(given, name) for name in ("runs", "fit_runs", "threads")}
    return {**own, "entropy": entropy}
