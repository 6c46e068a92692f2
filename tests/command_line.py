"""Calls of the command line, and the short settings of its tests."""

import json

from typer.testing import CliRunner

from spoofgym.cli import app

PAPERS = ["--env", "spoofgym/Zhong2025-v0"]
TIMES = ["--warmup-s", "20", "--live-s", "10", "--attack-s", "20", "--time-to-alert-s", "5"]
SHORT = [*PAPERS, *TIMES]
TRAINING = [*SHORT, "--training-runs", "11", "--alarm-budget", "0.25", "--threads", "1"]
FIXED = ["--nominal", "--selection-runs", "0", "--set", "domain={}"]
QUICK = [*TRAINING, *FIXED, "--runs", "4"]
TWO = ["--detector", "ewma", "--spoofer", "none", "--spoofer", "ramp:rate_mps=0.4"]


def call(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def read(*arguments):
    """What a command with ``--json`` prints."""
    result = call(*arguments)
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def refused(*arguments):
    """The one line that a wrong command prints."""
    result = call(*arguments)
    assert result.exit_code == 2, result.output
    (line,) = result.stderr.splitlines()
    assert line.startswith("spoofgym: error: ")
    return line
