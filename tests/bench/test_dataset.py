"""Data sets: what is in them, that they are whole, and that they come to the same after a kill."""

import json

import cloudpickle
import numpy as np
import pytest

from spoofgym.bench.experiments import Store, run_experiment
from spoofgym.bench.experiments.dataset import PARTS, Plan, load_dataset
from spoofgym.bench.experiments.training_attacks import FAMILIES
from spoofgym.bench.report.tasks import load_optima
from spoofgym.bench.runs.world import World
from spoofgym.simulation.setup import SPLITS
from spoofgym.spoofers import make_spoofer

from .experiments.support import content
from .support import LATE, SHORT, small_suite, write_policy

SIZES = {"train": 5, "validation": 2, "test": 2}
TERMS = ["innovation", "in-view", {"name": "classic", "detector": {"name": "snapshot-chi2"}}]
TEST = {"name": "snapshot-chi2", "thresholds": "nominal"}


def plan(world=None, **changes):
    given = {"runs": SIZES, "shard": 2, "terms": TERMS, "length_m": 20.0, **changes}
    return Plan(
        World.of(**{"scenario": "zhong2025", "timeline": SHORT, **(world or {})}).setup, **given
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "set"
    run_experiment(plan(), Store(path), threads=1)
    return path


def test_an_episode_has_its_observations_label_and_displacement(folder):
    data = load_dataset(folder)
    epochs = data.config["epochs"]
    assert epochs["all"] == 20 + 40 + 10
    for part, runs in SIZES.items():
        found = data.episodes(part)
        assert found.observation.shape == (2 * runs, epochs["all"], len(data.names))
        assert found.run.tolist() == np.repeat(np.arange(runs), 2).tolist()
        assert found.clean.tolist() == [True, False] * runs
        assert not found.attack[found.clean].any()
        assert not found.attack[:, : epochs["live"]].any()
        assert found.attack[~found.clean, epochs["live"] :].all()
        assert (found.displacement_m[~found.attack] == 0.0).all()
        assert (found.displacement_m[~found.clean].max(axis=1) > 0.0).all()
        assert (found.family[found.clean] == -1).all()
        named = [json.loads(text)["name"] for text in found.setting[~found.clean]]
        assert named == [data.config["families"][k] for k in found.family[~found.clean]]
        # twins are alike until the attack and no longer
        clean, attacked = found.observation[::2], found.observation[1::2]
        assert (clean[:, :20] == attacked[:, :20]).all()
        assert (clean[:, 20:] != attacked[:, 20:]).any(axis=(1, 2)).all()
    used = {SPLITS[PARTS[part]] for part in PARTS}
    assert len(used) == 3
    assert not used & {number for name, number in SPLITS.items() if name not in PARTS.values()}


def test_a_run_is_the_same_in_any_file_thread_and_process(folder, tmp_path):
    found = load_dataset(folder).episodes("train")
    for given in (plan(), cloudpickle.loads(cloudpickle.dumps(plan()))):
        for mine, theirs in zip(given.play("train", [3]), found, strict=True):
            assert (mine == theirs[6:8]).all()
    run_experiment(plan(), Store(tmp_path / "again"), threads=2)
    assert content(tmp_path / "again") == content(folder)


def test_attacks_of_all_families_are_drawn_and_some_are_hard_to_see():
    optima = load_optima("T3")
    assert {len(rates) for rates in optima} == {24}
    assert load_optima("T1") == load_optima("no task") == []
    attacks = plan(detector=TEST, optima=optima, spoofers=[{"name": "step"}]).attacks
    rng = np.random.default_rng(1)
    drawn = [attacks.draw(rng) for _ in range(400)]
    assert {attacks.families[k] for k, _ in drawn} == {*FAMILIES, "step"}
    for _, spec in drawn:
        make_spoofer(spec)
    goal = [spec["rate_mps"] * SHORT.attack_s for _, spec in drawn if spec["name"] == "ramp"]
    assert min(goal) < 20.0 / 4
    assert max(goal) > 20.0
    assert len({spec["heading_deg"] for _, spec in drawn if "heading_deg" in spec}) > 300
    assert np.bincount([k for k, _ in drawn]).min() > 30


OWN = {"code_sd_m": 0.0, "range_rate_sd_mps": 0.0}


@pytest.mark.parametrize(
    ("attack", "task", "message"),
    [
        ({"name": "false-position", "errors": "replaced"}, None, r"held out.*quiet"),
        ({"name": "false-position", "errors": OWN}, None, r"held out.*quiet"),
        ({"name": "false-position", "errors": "replaced"}, "T5", r"held out.*quiet"),
        ("meaconer", None, r"held out.*meaconer"),
        ({"name": "false-position", "channels": ["S01", "S02"]}, None, r"held out.*subset"),
    ],
)
def test_no_family_that_tasks_hold_out_is_in_a_data_set(folder, attack, task, message):
    config = load_dataset(folder).config
    assert not set(config["held_out"]) & set(config["families"])
    assert config["attack"]["errors"] == "inherited"
    with pytest.raises(ValueError, match=message):
        plan(world={"attack": attack}, task=task)
    assert plan(world={"attack": "quiet"}, task="T5").task == "T5"


def test_feedback_sees_its_detector_and_a_spoofer_may_be_a_file(tmp_path):
    write_policy(tmp_path / "late.onnx", small_suite(settings=LATE), "blind", (0.0, 0.02))
    write_policy(tmp_path / "often.onnx", small_suite(), "blind", (0.0, 0.02))
    farthest = []
    for name, more in (
        ("often", {"detector": TEST, "families": ["feedback"]}),
        ("often", {"families": []}),
        ("late", {"families": []}),
    ):
        spoofers = [{"name": str(tmp_path / f"{name}.onnx")}]
        found = plan(spoofers=spoofers, runs={"train": 6}, **more).play("train", range(6))
        assert set(found.family[~found.clean].tolist()) == set(range(1 + ("detector" in more)))
        moved = found.displacement_m[~found.clean].max(axis=1)
        assert (moved > 0.0).all()
        farthest.append(moved.max())
    # the first decision is a line from nothing: (1 + ... + 5) / 5 epochs instead of 5 of them
    assert farthest[2] < farthest[1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"runs": {"train": 0}}, "`runs\\['train'\\]` must be"),
        ({"runs": {"trial": 4}}, "unknown split of a data set 'trial'"),
        ({"families": ["feedback"]}, "needs a detector"),
        ({"families": ["open-loop"]}, "needs curves"),
        ({"spoofers": [{"name": "none"}]}, "transmits nothing"),
        ({"world": {"decision_interval_s": 5.0}}, "decision_interval_s"),
    ],
)
def test_bad_plans_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        plan(**changes)


def test_what_is_no_whole_data_set_is_refused_and_that_of_other_code_is_read(folder, tmp_path):
    mine, path = plan(runs={"train": 2, "test": 1}), tmp_path / "config.json"
    run_experiment(mine, Store(tmp_path), threads=1)
    with pytest.raises(ValueError, match="unknown split of this data set 'validation'"):
        load_dataset(tmp_path).episodes("validation")
    (tmp_path / "cells" / "train-0000.npz").unlink()
    with pytest.raises(ValueError, match=r"train-0000.npz is missing: `spoofgym dataset`"):
        load_dataset(tmp_path).episodes("train")
    load_dataset(tmp_path).episodes("test")
    config = json.loads(path.read_text())
    path.write_text(json.dumps({**config, "experiment": "game"}))
    with pytest.raises(ValueError, match="holds the experiment 'game' and not 'dataset'"):
        load_dataset(tmp_path)
    path.write_text(json.dumps({**config, "code": {**config["code"], "numpy": "1.0"}}))
    found = load_dataset(tmp_path).config
    assert found == load_dataset(folder).config | {name: found[name] for name in ("runs", "splits")}
    with pytest.raises(ValueError, match=r"code.numpy: '1.0', not"):
        run_experiment(mine, Store(tmp_path))


def test_where_ages_are_drawn_an_episode_is_as_long_as_it_is(tmp_path):
    aged = plan({"domain": {"turn_on": "drawn", "age_s": (15.0, 60.0)}}, runs={"train": 6}, shard=4)
    run_experiment(aged, Store(tmp_path), threads=1)
    data, setup = load_dataset(tmp_path), aged.world
    found, window = data.episodes("train"), setup.steps + setup.hold
    assert found.observation.shape[1] == data.config["epochs"]["all"] == setup.live + window
    assert len(np.unique(found.epochs)) > 3
    assert (found.epochs[::2] == found.epochs[1::2]).all()
    for part in (found.observation, found.attack, found.displacement_m):
        assert not part[~found.valid].any()
    assert found.observation[found.valid].any(axis=1).all()
    last = np.arange(found.attack.shape[1]) >= found.epochs[:, None] - window
    assert (found.attack[1::2] == (last & found.valid)[1::2]).all()
    assert not found.attack[::2].any()
    assert (found.displacement_m[1::2].max(axis=1) > 0.0).all()
    # each is that of a world in which all receivers are so old
    for run in (0, 1):
        age_s = (setup.filter_only + found.epochs[2 * run] - window) * setup.interval_s
        old = {"domain": {"turn_on": "drawn"}, "timeline": SHORT.aged(float(age_s))}
        alone = plan(old).play("train", [run])
        length = alone.observation.shape[1]
        assert length == found.epochs[2 * run]
        rows = slice(2 * run, 2 * run + 2)
        for mine, theirs in ((found.observation, alone.observation), (found.attack, alone.attack)):
            assert (mine[rows, :length] == theirs).all()
        assert (found.displacement_m[rows, :length] == alone.displacement_m).all()
