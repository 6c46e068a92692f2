"""Sizes of audits, of a task and of a log."""

from __future__ import annotations

from typing import NamedTuple

from ..search.open_loop import OpenLoopSearch


class AuditBudget(NamedTuple):
    """Size of an audit.

    - `runs`: evaluation runs of every family; `selection_runs`: those that its attacks are chosen
      on; `search`: of profiles against the detector;
    - `twins`: runs of every age; `ages`: how many of `AGES_S`;
    - `floor_worlds`: worlds of the floor where none is stored, None for all, 0 for no floor.
    """

    runs: int
    selection_runs: int
    search: OpenLoopSearch
    twins: int
    ages: int
    floor_worlds: int | None


BUDGETS = {
    "quick": AuditBudget(40, 24, OpenLoopSearch(runs=96, batch=24, generations=6), 16, 4, 0),
    "standard": AuditBudget(400, 96, OpenLoopSearch(runs=256), 64, 5, 4),
    "full": AuditBudget(1500, 384, OpenLoopSearch(), 192, 5, None),
}
"""Sizes by their names: about 1, 3 and 12 minutes of a processor for a plain detector in D1."""
SEARCHED = "o"
"""Letter of a family whose profiles are looked for against each detector."""
AGES_S, LIVE_AFTER_S = (30.0, 180.0, 600.0, 1800.0, 5400.0), 10.0
"""From switch-on to the onsets at which a detector meets the same ramps, and until it is live."""
RAMPS = (0.6, 1.2, 2.4, 4.8, 9.6)
"""How far these ramps displace by the end of the attack, in parts of the alert limit."""
FALSE_ALARMS, AGES, FLOOR = "false alarms", "ages", "floor"
"""Cells that are of no family."""
AGAIN, ALIKE = 8, 1e-6
"""Runs that are judged twice, and the largest difference of the two, in parts."""
