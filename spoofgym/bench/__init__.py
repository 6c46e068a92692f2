"""The benchmark: detectors x spoofers x paired seeds, and their scores.

suite      what is run, with a digest of everything that results depend on
victims    the four kinds of victim, with the detectors that suit each
decisions  a spoofer in front of an engine, from decision to decision
run        one cell: all runs side by side, from a warm-up that all spoofers share
scores     what a run, a spoofer and a detector are worth, each defined once
budget     how often a spoofer may be noticed where chance alone would be silent
tune       the strongest attack of a family within an alarm budget
attack_suite   whom every detector meets, a name and a version
protection     the worst attack of the suite, chosen on runs of its own
metrics    proportions and means with their intervals
campaign   all cells, each kept as soon as it is finished
summary    the scores of a campaign, read from its folder
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .campaign import run_campaign
    from .store import ResultsFolder
    from .suite import Suite, Tuning
    from .summary import summarize

__all__ = ["ResultsFolder", "Suite", "Tuning", "run_campaign", "summarize"]

_PLACES = {
    **{"ResultsFolder": "store", "Suite": "suite", "Tuning": "suite"},
    **{"run_campaign": "campaign", "summarize": "summary"},
}


def __getattr__(name: str) -> Any:
    """Import on demand: a worker that only needs a store loads nothing else."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
