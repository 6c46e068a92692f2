"""Kill commands at drawn moments until they end: `python -m tools.kills --kills 50`.

Each command plays once to its end, in a folder of its own. Then it begins in another folder, is
killed (SIGKILL) after a time that is drawn from 0 to what the whole took, and is given again, until
it ends. What it has written must then be what the first one wrote, byte for byte but for measured
times and what they are drawn into, and nothing else may lie there.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from spoofgym.cli import app
from spoofgym.core.registry import check_choice
from spoofgym.detectors.calibration_file import FOLDER_VARIABLE

TIMES = ("--warmup-s", "20", "--live-s", "10", "--attack-s", "20", "--time-to-alert-s", "5")
SHORT = ("--env", "spoofgym/Zhong2025-v0", *TIMES, "--threads", "1")
WORLD = {
    "timeline": {"warmup_s": 20, "live_s": 10, "attack_s": 20, "time_to_alert_s": 5},
    "domain": {},
}
COMMANDS: dict[str, tuple[str, ...]] = {
    "bench": (
        *("bench", *SHORT, "--out", "out", "--nominal", "--selection-runs", "0", "--runs", "8"),
        *("--training-runs", "80", "--detector", "ewma", "--detector", "snapshot-chi2"),
        *("--spoofer", "ramp", "--spoofer", "accelerating-ramp", "--spoofer", "step"),
    ),
    "audit": (
        *("audit", "snapshot-chi2:thresholds=nominal", "--out", "out", "--seed", "1", "--threads"),
        *("1", "--budget", "quick", "--runs", "16", "--selection-runs", "8"),
        *("--family", "ramps", "--family", "dashes", "--family", "quiet"),
    ),
    "dataset": (
        *("dataset", "out", *SHORT, "--train", "40", "--validation", "20", "--test", "20"),
        *("--file-runs", "4", "--detector", "snapshot-chi2:thresholds=nominal"),
    ),
    "game": (
        *("game", "--task", "T3", "--runs", "8", "--out", "out", "--threads", "1"),
        *("--detector", "snapshot-chi2:thresholds=nominal", "--detector", "ewma"),
        *("--spoofer", "none", "--spoofer", "ramp:rate_mps=0.2", "--spoofer", "step"),
    ),
    "calibrate": (
        *("calibrate", *SHORT, "--false-alarms-per-hour", "20", "--runs", "4000"),
        *("--detector", "snapshot-chi2", "--detector", "cusum"),
    ),
    "training": (
        *("--out", "out", "--task", "T1", "--detector", "snapshot-chi2:thresholds=nominal"),
        *("--settings", json.dumps(WORLD), "--steps", "400", "--num-envs", "5"),
        *("--batch-size", "50", "--n-epochs", "2", "--full-scale-mps", "1", "--stages", "4"),
        *("--decision-interval-s", "2.5", "--fit-runs", "80", "--runs", "20", "--rivals"),
        *("ramp", "--seeds", "0", "--threads", "1"),
    ),
}
MEASURED = re.compile(rb'"(wall_s|spent_s|cost_us|seconds|date)": *"?[^,}"]*"?')
DRAWN, ARCHIVES = (".png", ".html"), (".npz", ".zip")
"""Files of measured times, and those whose members are compared, as they have dates."""
REMOVED = "out/unfinished/"
"""Clean runs of a calibration, which are removed when it has been written."""
QUICK_S = 0.05
"""Before which a kill comes too early to have anything to do with what is written."""


class Kills(NamedTuple):
    """What came of a command: how often it was killed and ended, and what differed."""

    kills: int
    ends: int
    whole_s: float
    faults: tuple[str, ...]


def play(name: str) -> int:
    """One of `COMMANDS` in the current folder: its exit status."""
    words = list(COMMANDS[name])
    try:
        if name == "training":
            from train.ppo_spoofer import main

            sys.argv = ["ppo_spoofer", *words]
            main()
        else:
            app(words, standalone_mode=True)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    return 0


def play_in_child(name: str, folder: Path, after_s: float | None) -> int | None:
    """Exit status of a command in a child process; None where it was killed after a time."""
    child = os.fork()
    if child == 0:
        status = 1
        with contextlib.suppress(BaseException):
            os.setsid()
            os.environ[FOLDER_VARIABLE] = str(folder / "out")
            os.chdir(folder)
            log = os.open(folder.with_suffix(".log"), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            os.dup2(log, 1), os.dup2(log, 2)
            status = play(name)
        os._exit(status)
    end = None if after_s is None else time.monotonic() + after_s
    while not (done := os.waitpid(child, 0 if end is None else os.WNOHANG))[0]:
        if end is not None and time.monotonic() > end:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return None
        time.sleep(0.005)
    return os.waitstatus_to_exitcode(done[1])


def read_content(folder: Path) -> dict[str, bytes]:
    """Files by name, without measured times."""
    found = {}
    for path in sorted(each for each in folder.rglob("*") if each.is_file()):
        name = path.relative_to(folder).as_posix()
        if name.startswith(REMOVED):  # a kill meanwhile leaves some, which nothing reads
            continue
        if path.suffix in ARCHIVES:
            with zipfile.ZipFile(path) as archive:
                found |= {f"{name}/{x}": archive.read(x) for x in archive.namelist()}
        else:
            found[name] = b"" if path.suffix in DRAWN else path.read_bytes()
    return {name: MEASURED.sub(b"", content) for name, content in found.items()}


def kill_often(name: str, kills: int, folder: Path) -> Kills:
    draw = random.Random(name)
    for whole in (folder / "first", folder / "whole"):
        begun = time.monotonic()
        whole.mkdir()
        if play_in_child(name, whole, None) != 0:
            raise RuntimeError(whole.with_suffix(".log").read_text()[-500:])
    whole_s, expected = time.monotonic() - begun, read_content(whole)
    faults = [] if read_content(folder / "first") == expected else ["two whole runs differ"]
    killed, ends = 0, 0
    while killed < kills:
        again = folder / f"again-{ends}"
        again.mkdir()
        for _ in range(100):
            wait_s = draw.uniform(QUICK_S, whole_s) if killed < kills else None
            status = play_in_child(name, again, wait_s)
            killed += status is None
            if status is not None:
                break
            print(f"{name}: kill {killed} of {kills}", file=sys.stderr)  # no bar: it has a thread
        found, ends = read_content(again), ends + 1
        changed = sorted(x for x in {*found, *expected} if found.get(x) != expected.get(x))
        faults += [f"exit status {status}"] if status else []
        faults += [f"{x} differs" for x in changed]
        if not faults:
            shutil.rmtree(again)
    return Kills(killed, ends, whole_s, tuple(faults))


def main(
    commands: Annotated[list[str] | None, typer.Argument(help="By default all.")] = None,
    kills: Annotated[int, typer.Option(help="Of each command.", min=1)] = 50,
    out: Annotated[Path | None, typer.Option(help="Folder that keeps what differs.")] = None,
) -> None:
    """Kill commands at drawn moments until they end, and compare what they write."""
    chosen: Sequence[str] = commands or list(COMMANDS)
    for name in chosen:
        check_choice("command", name, COMMANDS)
    if "training" in chosen:
        import train.ppo_spoofer  # noqa: F401  # once, and not in every child
    failed = False
    for name in chosen:
        folder = Path(tempfile.mkdtemp(prefix=f"kills-{name}-", dir=out))
        found = kill_often(name, kills, folder)
        failed |= bool(found.faults)
        said = "; ".join(dict.fromkeys(found.faults)) or "the same bytes"
        print(f"{name}: {found.kills} kills, {found.ends} ends ({found.whole_s:.1f} s): {said}")
        sys.stdout.flush()
        if out is None:
            shutil.rmtree(folder)
    raise typer.Exit(int(failed))


if __name__ == "__main__":
    typer.run(main)
