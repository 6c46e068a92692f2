"""The README's code runs and prints what it says."""

import json
import math
import re
import sys
import tomllib
import types

import pytest

from spoofgym.bench.scores.campaign import headline
from spoofgym.cli.demo import RATE_MPS
from spoofgym.simulation.setup import Timeline
from spoofgym.tasks import get_task
from spoofgym.testing import check_detector
from tools.headlines import DATA_FILE as FULL
from tools.pages import part_between
from tools.readme_bench import (
    END,
    SHARED,
    SHOWN,
    START,
    WORLD,
    label,
    read_learned,
    shared_rows,
    shown,
)
from tools.readme_figures import read_parts

from .pages import ROOT, blocks_of, play, text_of
from .test_tutorials import read_cells

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")

README = text_of("README.md")
BLOCKS = [code for _, code in blocks_of("README.md")]
LINE = '{"warmup_s": 6, "live_s": 3, "attack_s": 20, "time_to_alert_s": 1}'
NOMINAL = '"detector": {"name": "ewma", "thresholds": "nominal"}'
SMALLER = [
    ('"timeline": None', f'"timeline": {LINE}'),
    ('"detector": "ewma"', NOMINAL),
    (r"SpoofVecEnv\(256,", "SpoofVecEnv(4,"),
    ('"warm_pool": 256', '"warm_pool": 4'),
    ('"n_steps": 15, "batch_size": 960', '"n_steps": 2, "batch_size": 8'),
    (r"learn\(300_000\)", "learn(40)"),
    ('rule="exact"', 'rule="exact", runs=60, fit_runs=80'),
    (r"range\(100\)", "range(2)"),
]


@pytest.fixture
def saved(monkeypatch):
    module = types.ModuleType("my_detector")
    monkeypatch.setitem(sys.modules, module.__name__, module)  # pickle looks classes up
    assert f"Saved as `{module.__name__}.py`" in README
    exec(compile(BLOCKS[-1], "my_detector.py", "exec"), module.__dict__)
    return module


def test_every_block_of_code_runs_and_each_goes_on_from_the_one_before(
    capsys, monkeypatch, tmp_path
):
    for module in ("matplotlib", "onnxscript", "stable_baselines3"):
        pytest.importorskip(module)
    monkeypatch.chdir(tmp_path)
    play("README.md", monkeypatch, SMALLER)
    model, ramp, *alarms = capsys.readouterr().out.splitlines()
    assert model.startswith("PPO (blind, amplitude ")
    assert ramp.startswith("ramp(tuned) (blind, rate_mps ")
    assert [line.split()[:3] for line in alarms] == [
        ["ewma", "1", "clean"],
        ["snapshot-chi2", "1", "clean"],
    ]
    assert {path.name for path in tmp_path.iterdir()} == {"ppo.onnx", "ppo.json"}


def test_it_is_short_and_its_figures_are_those_of_the_stored_results(full):
    assert len(README.splitlines()) <= 120
    (row,) = re.findall(r"\| D1 \| solution-sep.*augmented.*", text_of("submit.md"))
    audited, ends = row.split("|")[4].split(",")[0].split(maxsplit=1)
    assert f"with its own filter, allows {float(audited):.0f} m {ends}" in README
    assert f"in {read_hazard(text_of('detector_tasks.md'))} % of the runs (P(HMI), 200" in README
    best = headline(full["protection"][2], 0.5)["value"]
    assert best == min(headline(row, 0.5)["value"] for row in full["protection"])
    _, rows = part_between(README, START, END).split("|---|---|---|---|---|")
    assert len([line for line in rows.splitlines() if line.startswith("| ")]) <= 6


def read_hazard(page):
    """P(HMI) of D1's best detector [%], as its card prints it."""
    (row,) = re.findall(r"\| D1 \| solution-sep.*augmented.*early.*", page)
    return row.split("|")[3].split()[0]


def test_detector_campaign_extras_and_times_are_those_that_it_names(saved, full):
    check_detector(saved.AverageRate())
    (command,) = re.findall(r"`(spoofgym bench -.*?)`", README)
    assert command.startswith(f"{full['command']} --detector my_detector:AverageRate ")
    extras = tomllib.loads(text_of("pyproject.toml"))["project"]["optional-dependencies"]
    first, *more = re.findall(r"^pip install '?\.(?:\[(.*)\])?", README, flags=re.MULTILINE)
    named = {extra for line in more for extra in line.split(",")}
    assert first == ""
    assert {"report", "flights", "train"} <= named <= {*extras}
    settings = get_task(WORLD).world_kwargs
    assert settings["scenario"]["name"] == full["scenario"].partition(" ")[0]
    line = Timeline(**settings.get("timeline", {}))
    assert f"attacks last {line.attack_s:.0f} s" in README


def test_the_table_is_that_of_the_full_run(full):
    assert part_between(README, START, END) == f"\n{shown(full, read_learned())}"
    assert full["campaign"] in README
    names = [label(row["detector"]) for row in full["detectors"]]
    assert {*SHOWN} <= {*names}


@pytest.fixture(scope="module")
def full():
    return json.loads(FULL.read_text())["worlds"][WORLD]


@pytest.fixture(scope="module")
def kept():
    return json.loads(text_of("readme.json"))


def read_notebook(name):
    """Code of a tutorial's cells, and the lines that they have printed."""
    cells = read_cells(ROOT / f"docs/tutorials/{name}.ipynb")
    outputs = [each for cell in cells for each in cell["outputs"] if "text" in each]
    printed = "".join("".join(each["text"]) for each in outputs).splitlines()
    return "\n".join("".join(cell["source"]) for cell in cells), printed


def test_examples_are_the_code_and_the_commands_that_were_played(kept):
    parts = read_parts(README)
    assert {*parts} == {*kept}
    for name, part in parts.items():
        played = {key: kept[name][key] for key in part}
        assert played == part, f"python -m tools.readme_figures {name}"


def test_the_training_is_that_of_the_tutorial_and_has_its_scores():
    code, printed = read_notebook("train_a_spoofer")
    (block,) = (each for each in BLOCKS if "PPO(" in each)
    lines = re.sub("  #.*", "", block.replace(".learn(300_000)", "")).splitlines()
    assert [line for line in lines if line not in code.splitlines()] == []
    assert ".learn(300_000)" in block
    assert "learn(300_000," in code
    model, ramp = (line for line in printed if " m at 5 % of alarms" in line)
    form = r": ([\d.]+) \(([\d.]+) to ([\d.]+)\) m at 5 % of alarms.* of 397 runs"
    learned, pulled = (re.search(form, line).groups() for line in (model, ramp))
    here = "PPO reaches {} m (95 % interval {} to {};".format(*learned)
    elsewhere = f"[{learned[0]} m](docs/promises.md#reproducibility) on another kind of processor"
    assert here in README or elsewhere in README, learned
    assert "the best ramp {} m ({} to {})".format(*pulled) in README
    assert "Of 400 runs 397 are silent without an attack" in README


def test_the_audit_is_that_of_the_tutorial_and_ends_as_it_did():
    code, printed = read_notebook("audit_a_detector")
    (own,) = re.findall(r"^class AverageRate.*", BLOCKS[-1], flags=re.M | re.S)
    assert own.strip() in code
    assert "spoofgym audit my_detector:AverageRate --budget quick\n" in README
    (seed,) = re.findall(r"^With `--seed (\d+)` the audit", README, flags=re.M)
    assert f'spoofgym.audit(AverageRate, "D1", "quick", entropy={seed})' in code
    (said,) = re.findall(r"Its last line is `(.*?)`", README)
    assert printed[-1] == said
    failed = any("the search failed" in line for line in printed)
    assert ("the audit warned that its search failed" in README) == failed


def test_the_wrappers_have_the_figures_that_they_printed(kept):
    form = (
        r"(\S+) 50 clean and 50 attacked episodes: (\S+) \((\S+) to (\S+)\) false alarms an hour, "
    )
    form += r"(\S+) \((\S+) to (\S+)\) of the attacks missed, .* displacement (.*) m"
    ewma, chi2 = (re.fullmatch(form, line).groups() for line in kept["wrapper"]["printed"])
    assert (ewma[0], chi2[0]) == ("ewma", "snapshot-chi2")
    missed = [f"{100.0 * float(x):.0f}" for x in ewma[4:7]]
    moved, ends = ewma[7].split(" ", 1)
    assert f"`ewma` misses {missed[0]} % of the attacks ({missed[1]} to {missed[2]})" in README
    assert f"lets {moved} m pass undetected {ends}" in README
    assert float(chi2[4]) == 0.0
    assert f"`snapshot-chi2` misses none (0 to {100.0 * float(chi2[6]):.0f} %)" in README
    rates = (f"`{x[0]}` {x[1]} ({x[2]} to {x[3]})" for x in (ewma, chi2))
    assert f"False alarms an hour: {', '.join(rates)}" in README


def test_the_demo_is_the_attack_of_the_animation(kept):
    missed, found = (line for line in kept["demo"]["printed"] if " raises " in line)
    (metres,) = re.findall(r"the position ends ([\d.]+) m off", missed)
    assert f"the position ends {float(metres):.0f} m off" in README
    assert float(re.findall(r"after ([\d.]+) s", found)[0]) < 10.0
    assert f"aside by {RATE_MPS} m/s for 150 s" in README
    assert "set to 0.2 false alarms an hour" in README


def test_make_bench_plays_rows_of_the_full_run_and_agrees_by_interval(full):
    kept, whole = json.loads(SHARED.read_text())["rows"], shared_rows(full)
    makefile = (ROOT / "Makefile").read_text()
    named = re.search(r"bench_detectors = \$\(addprefix --detector ,(.*?)\)", makefile, re.DOTALL)
    played = {spec.split(":")[0] for spec in named[1].split() if spec != "\\"}
    played |= {"never", "lottery"}
    assert {name.partition("(")[0] for name in kept} == played
    for name, scores in kept.items():
        assert {*scores} == {*whole[name]}
        for score, one in scores.items():
            other = whole[name][score]
            apart = one["low"] - other["high"]
            less = other["low"] - (math.inf if one["high"] is None else one["high"])
            if score.startswith("exceeded"):  # a quick search finds less, and never more
                assert one["value"] >= 0.7 * other["value"], (name, score)
                assert apart <= 0.01 * abs(other["value"]), (name, score)
            else:  # the whole way of an attack has an interval of some centimetres
                assert max(apart, less) <= 1e-3 * abs(other["value"]), (name, score)


def test_the_first_commands_stand_in_blocks_of_their_own():
    blocks = "\n".join(re.findall(r"```console\n(.*?)```", README, flags=re.S))
    for command in ("spoofgym demo", "make bench", "make test", "spoofgym audit my_detector"):
        assert re.search(rf"^{command}", blocks, flags=re.M), command
