"""The benchmark: detectors x spoofers x paired seeds, and their scores.

runs         worlds, players, and what they did in one run
scores       what a run, a spoofer and a detector are worth
search       amplitudes, worst attacks, optimized open-loop attacks
experiments  what is played, stored and resumed: campaign, protection, data set, game
report       tables, figures and texts
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .experiments.campaign import CampaignResults, run_campaign, summarize
    from .experiments.suite import Suite
    from .search.amplitude import Tuning

__all__ = ["CampaignResults", "Suite", "Tuning", "run_campaign", "summarize"]

_PLACES = {
    "CampaignResults": "experiments.campaign",
    "Suite": "experiments.suite",
    "Tuning": "search.amplitude",
    "run_campaign": "experiments.campaign",
    "summarize": "experiments.campaign",
}


def __getattr__(name: str) -> Any:
    """Import on demand: a worker that only needs a store loads nothing else."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
