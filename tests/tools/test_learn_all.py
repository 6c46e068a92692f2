"""All trainings by one command: what has ended is not run again, and every command is one."""

import importlib.util
import json
import os
import subprocess
import sys
from itertools import pairwise

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
for name in ("torch", "tyro"):  # of what the steps run
    pytest.importorskip(name)

from spoofgym.tasks import DETECTOR_TASKS, TASKS
from tools.learn_all import MARKS, Step, list_steps, main, run


def writing(path):
    return Step(["-c", f"open({str(path)!r}, 'a').write('x')"])


def test_a_killed_run_goes_on_with_the_step_that_was_not_finished(tmp_path):
    first, last = tmp_path / "first", tmp_path / "last"
    failing = Step(["-c", "print('out'); import sys; sys.exit('the cause')"])
    fails = {"one": writing(first), "two": failing, "three": writing(last)}
    with pytest.raises(subprocess.CalledProcessError, match="status 1"):
        run(tmp_path / "out", fails)
    assert not last.exists()
    log = (tmp_path / "out" / "two.log").read_text()
    assert sorted(log.split("\n")) == ["", "out", "the cause"]
    done = run(tmp_path / "out", {**fails, "two": writing(last)})
    assert list(done) == ["one", "two", "three"]
    assert all(step["seconds"] >= 0.0 for step in done.values())
    assert json.loads((tmp_path / "out" / MARKS).read_text()) == done
    run(tmp_path / "out", {"one": writing(last), "three": writing(last)})
    assert first.read_text() == "x"
    assert last.read_text() == "xxx"  # "one" has another command now


def test_every_task_and_every_page_has_its_step(tmp_path):
    steps, folders = list_steps(tmp_path), {}
    names = [*steps]
    assert {f"ppo-{key}" for key in TASKS} | {f"cards-{key}" for key in DETECTOR_TASKS} <= {*steps}
    for name, step in steps.items():
        assert importlib.util.find_spec(step.words[1]) is not None
        assert all(names.index(sooner) < names.index(name) for sooner in step.after)
        if "--out" in step.words:
            folders.setdefault(step.words[step.words.index("--out") + 1], []).append(name)
    assert {"spoofers-T5-aime", "refits", "fresh-T1", "plain-T2", "ppo-T6"} <= {
        *steps["page"].after
    }
    # commands that write to the same place wait for each other
    alike = [names for names in folders.values() if len(names) > 1]
    assert alike == [["feedback", "feedback-T2"]]
    cards = [name for name in steps if name.startswith("cards-")]
    for sooner, later in [*map(tuple, alike), *pairwise(cards)]:
        assert sooner in steps[later].after


MEET = """
import json, os, pathlib, sys, time
mine, other = map(pathlib.Path, sys.argv[1:])
mine.write_text(json.dumps(sorted(os.sched_getaffinity(0))) if sys.platform == "linux" else "")
until = time.monotonic() + 60
while not other.exists() and time.monotonic() < until:
    time.sleep(0.01)
raise SystemExit(0 if other.exists() else 4)
"""
"""Ends well only where another one runs at the same time; leaves the processors that it has."""


@pytest.mark.nightly  # processes that import all, one after the other on a busy machine
def test_workers_run_at_once_share_the_processors_and_what_is_needed_ends_before(tmp_path):
    one, two, seen = tmp_path / "one", tmp_path / "two", tmp_path / "seen"
    last = f"import os; open({str(seen)!r}, 'w').write(str(os.path.exists({str(two)!r})))"
    steps = {
        "last": Step(["-c", last], ("first", "second")),
        "first": Step(["-c", MEET, str(one), str(two)]),
        "second": Step(["-c", MEET, str(two), str(one)]),
    }
    assert {*run(tmp_path / "out", steps, workers=2)} == {*steps}
    assert seen.read_text() == "True"
    if sys.platform == "linux":  # elsewhere the system shares them itself
        own = sorted(os.sched_getaffinity(0))
        first, second = (json.loads(path.read_text()) for path in (one, two))
        assert sorted(first + second) == (own if len(own) > 1 else own * 2)
        run(tmp_path / "alone", {"it": Step(["-c", MEET, str(tmp_path / "alone.txt"), str(one)])})
        assert json.loads((tmp_path / "alone.txt").read_text()) == own


def test_steps_can_be_listed_and_are_checked(tmp_path, capsys):
    main(["--out", str(tmp_path), "--only", "game-page", "ppo-T6", "--list"])
    assert capsys.readouterr().out.splitlines() == [
        f"ppo-T6: python -m train.ppo_spoofer --task T6 --warm-pool 512 --out {tmp_path}/ppo-T6",
        f"game-page: python -m tools.game_page {tmp_path}/game",
    ]
    with pytest.raises(SystemExit, match=r"^error: unknown step 'ppo-T9'"):
        main(["--out", str(tmp_path), "--only", "ppo-T9"])
