"""The command line: ``spoofgym list | card | run | render | tune | bench | tasks | report | perf``.

Nothing that is slow to load is imported before a command needs it.
"""

from .app import INTERRUPTED, app, clear_errors, main
from .bench import bench, report, tune
from .listing import card, list_, tasks
from .perf import perf
from .run import render, run

__all__ = ["INTERRUPTED", "app", "clear_errors", "main"]

# in the order of the help page
app.command("list")(clear_errors(list_))
for _command in (card, run, render, tune, bench, tasks, report, perf):
    app.command()(clear_errors(_command))
