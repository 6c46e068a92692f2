"""The command line: ``spoofgym --help`` lists its commands.

Nothing that is slow to load is imported before a command needs it.
"""

from .app import INTERRUPTED as INTERRUPTED
from .app import app as app
from .app import clear_errors as clear_errors
from .app import main as main
from .audit import audit_
from .bench import bench, report
from .calibrate import calibrate
from .dataset import dataset
from .demo import demo
from .game import game
from .limits import limits
from .list import list_
from .log import group as log_group
from .run import run
from .warmup import warmup

# in the order of the help page
app.command("list")(clear_errors(list_))
app.command("audit")(clear_errors(audit_))
for _command in (demo, calibrate, run, bench, game, limits, dataset, report, warmup):
    app.command()(clear_errors(_command))
app.add_typer(log_group, name="log")
