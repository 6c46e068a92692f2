"""Tasks for detectors: what is public, what is held out, and how they are named."""

import json
from contextlib import nullcontext

import pytest

import spoofgym
from spoofgym.attacks import make_attack
from spoofgym.bench.experiments import audit_worlds
from spoofgym.bench.experiments.audit import Auditor
from spoofgym.bench.experiments.audit_cells import SEARCHED
from spoofgym.bench.experiments.suite import list_task_detectors
from spoofgym.bench.report import tasks as detector_cards
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.search.attack_suite import FAMILIES
from spoofgym.detectors import make_detector
from spoofgym.duel.learner import LearnersSide
from spoofgym.spoofers import make_spoofer
from spoofgym.tasks import DETECTOR_TASKS, ONSETS, TASKS, get_detector_task, v2
from tests.bench.detector_support import small_task
from tests.command_line import call, read
from tests.detectors.learned.files import edit_card, write_guard
from tests.nightly import heavy
from tools.detector_cards import END, PAGE, START, list_unscored, shown, with_others
from tools.pages import part_between

WORLDS = {"D1": "S1", "D2": "S2", "D3": "S3"}
WORLDS |= {"v1/D1": "T3", "v1/D2": "T4", "v1/D3": "T5", "v1/D4": "T6"}
each_task = pytest.mark.parametrize("key", DETECTOR_TASKS)


@each_task
def test_held_out_families_are_not_in_the_public_pool(key):
    task = DETECTOR_TASKS[key]
    assert task.task is TASKS[WORLDS[key]]
    keys = [each.key for each in task.families]
    assert keys == [each.key for each in (*task.public, *task.held_out)], "public ones come first"
    assert not {each.key for each in task.public} & {each.key for each in task.held_out}
    for family in task.public:  # in the task's own world, at any onset
        assert (task.get_overrides(family), family.onset) == ({}, None)
        assert family.letters in {*FAMILIES, SEARCHED}
    for family in task.held_out:
        assert task.get_overrides(family) or family.onset in ONSETS
    # what a learner meets is in the task's own world, too: the spoofers alone are the pool's
    assert task.world_kwargs == TASKS[WORLDS[key]].world_kwargs
    within = {"onset": "within"} if key in v2.DETECTOR_TASKS else {}
    assert task.env_kwargs == {**task.world_kwargs, **within, "pool": task.pool}
    names = {make_spoofer(spec) and spec["name"] for spec in task.pool}
    assert names == {"ramp", "accelerating-ramp", "profile", "dash", "feedback"}
    assert [*map(json.dumps, task.pool)] == [*dict.fromkeys(map(json.dumps, task.pool))]
    # errors that are inherited, or quiet, are held out where the task's own are the other kind
    own = make_attack(task.world_kwargs.get("attack", "false-position"))
    other = "inherited" if own.label == "quiet" else "quiet"
    assert (own.label == "quiet") == (key == "v1/D3")
    errors = make_attack(task.family(other).attack).errors
    assert (errors == "inherited") == (other == "inherited")
    side = LearnersSide.of(None, key, "detector", None, None, {})
    assert (side.env_id, side.side, side.pool) == (task.env_id, "detector", task.pool)
    assert side.settings == {**task.world_kwargs, **within}


def test_names_are_told_apart_and_copies_handed_out():
    assert LearnersSide.of(None, "D1", "detector", ["ramp"], None, {}).pool == ["ramp"]
    with pytest.raises(ValueError, match=r"unknown task for detectors 'D9'; valid: D1.*v1/D4"):
        get_detector_task("D9")
    with pytest.raises(
        ValueError, match=r"unknown family of attacks of v1/D3 'quiet'; valid: .*inhe"
    ):
        get_detector_task("v1/D3").family("quiet")
    with pytest.raises(ValueError, match="D1 is for detectors: it needs `side` 'detector'"):
        LearnersSide.of(None, "D1", "spoofer", None, None, {})
    with pytest.raises(ValueError, match="unknown task 'D1'"):
        spoofgym.evaluate("ramp", "D1")
    task = get_detector_task("v1/D3")
    task.get_overrides(task.family("subset"))["attack"]["channels"].clear()
    task.pool.clear()
    task.env_kwargs["domain"].clear()
    assert task.get_overrides(task.family("subset"))["attack"]["channels"]
    assert task.pool
    assert task.env_kwargs["domain"]


@pytest.mark.parametrize("key", heavy(DETECTOR_TASKS, "D2", "D3", "v1/D2", "v1/D3", "v1/D4"))
def test_classics_have_the_tasks_own_bank_and_both_controls(key):
    specs = list_task_detectors(DETECTOR_TASKS[key].task)
    assert {"never", "lottery", "solution-separation"} <= {spec["name"] for spec in specs}
    assert len({specify_detector(spec).label for spec in specs}) == len(specs)
    banks = [spec for spec in specs if spec["name"] == "solution-separation"]
    assert [each.get("filter") for each in banks] == [
        *["augmented"] * (key in v2.DETECTOR_TASKS),
        None,
    ]
    assert ("longest_s" in banks[0]) == (key not in ("v1/D1", "v1/D3", "v1/D4"))
    for spec in specs:
        make_detector(spec)


@pytest.mark.parametrize(("key", "warns"), [("v1/D1", False), ("v1/D3", True)])
def test_a_learned_detector_is_warned_of_where_it_has_met_what_is_held_out(key, warns, tmp_path):
    path = write_guard(tmp_path, threshold=0.9)
    edit_card(path, training={"task": "T3", "held_out": ["quiet"]})
    guard = {"name": str(path), "threshold": 0.9}
    told = pytest.warns(UserWarning, match="guard.* has learned from inherited")
    with told if warns else nullcontext():
        Auditor(key).worlds.build_detectors([guard, "never"])


def test_the_list_names_every_family_that_an_audit_takes():
    shown = {word.strip(",") for word in call("list", "D1").output.split()}
    assert shown >= {each.key + "*" * each.held_out for each in DETECTOR_TASKS["D1"].families}


@pytest.mark.usefixtures("default_rate")  # of which labels say nothing
def test_cards_are_of_these_tasks_as_is_the_page_and_what_is_missing_has_its_command():
    cards, missing = detector_cards.stored_detector_cards(), detector_cards.missing()
    assert {*cards} | {*missing} >= {*v2.DETECTOR_TASKS}
    assert not {*cards} & {*missing}
    assert all(key in command for key, command in missing.items())
    for key, card in cards.items():
        task = DETECTOR_TASKS[key]
        for score in card["detectors"]:
            families = {each["family"]: each for each in score["families"]}
            assert list(families) == [family.key for family in task.families], (
                f"{key} has a card of other families: `python -m tools.detector_cards {key}`, hours"
            )
            worst = max(each["p_hmi"]["value"] for each in families.values())
            assert score["p_hmi"]["value"] == worst
            assert families[score["worst_family"]]["p_hmi"]["value"] == worst
            assert score["alert_limit_m"] == task.alert_limit_m
        by_name = {score["detector"]: score for score in card["detectors"]}
        assert by_name[card["best_classic"]]["less_best"]["value"] == 0.0
        assert by_name["never"]["p_hmi"]["value"] == 1.0
        chance = by_name["lottery"]["less_best"]
        assert chance["low"] <= by_name["never"]["less_best"]["value"] <= chance["high"]
    assert part_between(PAGE.read_text(), START, END) == f"\n{shown()}"


@pytest.mark.nightly
@pytest.mark.usefixtures("default_rate")
def test_every_reference_has_a_score_or_is_refused_or_is_named_as_unplayed():
    for key, card in detector_cards.stored_detector_cards().items():
        assert all("is degenerate" in why for why in card["left_out"].values())
        waiting = list_unscored(DETECTOR_TASKS[key], card)
        assert all(label in PAGE.read_text() for label in waiting)


def test_a_card_keeps_the_rows_of_the_same_runs_and_no_others():
    rows = [{"detector": name, "runs": 2} for name in ("mine", "theirs", "never", "best")]
    same = {"runs": 2, "selection_runs": 4, "entropy": 0, "best_classic": "best"}
    stored = {**same, "detectors": rows, "left_out": {"cusum": "degenerate", "never": "was"}}
    few = rows[2:]
    card = {**same, "detectors": few, "left_out": {"mine": "degenerate"}}
    whole = with_others(card, stored)
    assert [each["detector"] for each in whole["detectors"]] == ["never", "best", "theirs"]
    assert whole["left_out"] == {"cusum": "degenerate", "mine": "degenerate"}
    assert with_others({**card, "selection_runs": 7}, stored)["detectors"] == few
    other = [rows[2], {**rows[3], "runs": 3}]
    assert with_others({**card, "detectors": other}, stored)["detectors"] == other


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["never", "--task", "T3"], "unknown task for detectors 'T3'"),
        (["cusun"], "did you mean 'cusum'?"),
        (["nosuch:Thing"], "raises ValueError: there is no module 'nosuch'"),
        (["never", "--selection-runs", "1"], "selection-runs"),
        (["never", "--budget", "huge"], "unknown budget 'huge'; valid: full, quick, standard"),
    ],
)
def test_bad_options_are_refused(words, message, tmp_path):
    result = call("audit", *words, "--out", tmp_path)
    assert result.exit_code == 2
    assert message in " ".join(result.output.split())


def test_the_command_line_audits_goes_on_and_writes_attacks_that_play_again(tmp_path, monkeypatch):
    monkeypatch.setitem(DETECTOR_TASKS, "D1", small_task())
    words = ["audit", "never", "--budget", "quick", "--family", "ramps", "--runs", "4"]
    words += ["--selection-runs", "4", "--threads", "1", "--out", str(tmp_path)]
    (found,) = read(*words, "--json")
    assert found["p_hmi"]["value"] == 1.0
    assert found["warnings"] == ["never alarms, with an attack or without one"]
    assert len(list(tmp_path.rglob("*.npz"))) == 3  # a family, false alarms, ages
    monkeypatch.setattr(audit_worlds, "Panel", None)  # nothing is played again
    lines = call(*words).stdout.splitlines()
    assert lines[-1] == found["answer"]
    assert lines[-1].startswith("never: ")
    assert lines[-2] == f"Report: {tmp_path / 'small' / 'report.html'}"
    assert len(lines) <= 41
    assert max(map(len, lines[:-2])) <= 100
    for name in ("ramps", "worst"):
        attack = make_spoofer(str(tmp_path / "small" / "attacks" / f"never-{name}.json"))
        assert attack.rate_mps == pytest.approx(found["families"][0]["value"])
