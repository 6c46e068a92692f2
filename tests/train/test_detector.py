"""Training of a detector, end to end, with settings that take seconds."""

import json
import shutil
import sys
from dataclasses import replace
from functools import cache
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("onnxscript", "stable_baselines3", "tyro"):
    pytest.importorskip(name)

from rich.console import Console

from agents.detector_loss import compute_undetected
from agents.detector_score import score_non_learned, score_statistic
from agents.record import read_record
from spoofgym.bench.experiments import Store, run_experiment
from spoofgym.bench.experiments.dataset import Dataset, Episodes, Plan, load_dataset
from spoofgym.bench.runs.play import WarmStart, play
from spoofgym.bench.runs.record import compute_displacement
from spoofgym.bench.runs.world import World
from spoofgym.detectors import make_detector
from spoofgym.simulation.setup import make_generators, seeds_of_runs
from train import detector as module
from train.detector import CHECKPOINT, RECORD, Arguments, Trainer, train

TIMES = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 30.0, "time_to_alert_s": 2.0}
QUIET = Console(quiet=True)
OFTEN = 30.0
"""False alarms an hour that few clean runs can tell."""


@cache
def setup():
    return World.of(scenario="zhong2025", timeline=TIMES).setup


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "set"
    classic = {"name": "classic", "detector": {"name": "snapshot-chi2"}}
    terms = ("innovation", "in-view", "line-of-sight", classic)
    runs = {"train": 12, "validation": 8, "test": 8}
    run_experiment(Plan(setup(), length_m=10.0, terms=terms, runs=runs), Store(path), threads=1)
    return path


def arguments(data, out, **changes):
    small = {"passes": 3, "batch_size": 8, "width": 8, "projections": 2, "least_live_s": 2.0}
    return Arguments(data=data, out=out, false_alarms_per_hour=OFTEN, **{**small, **changes})


@pytest.fixture(scope="module")
def file(data, tmp_path_factory):
    return train(arguments(data, tmp_path_factory.mktemp("whole") / "guard"), QUIET)


@pytest.fixture
def trainer(data, tmp_path):
    """One that knows the scales, and has not learned yet."""
    made = Trainer(arguments(data, tmp_path / "guard"), load_dataset(data))
    made.normalize(made.data.episodes("train"))
    return made


def test_what_was_trained_is_a_detector_like_any_other(data, file):
    points = read_record(file.parent / RECORD)
    assert [point["step"] for point in points] == [1, 2, 3]
    assert points[-1]["train_loss"] < points[0]["train_loss"]
    card = json.loads(file.with_suffix(".json").read_text())["training"]
    made_of = load_dataset(data)
    assert card["data"] == made_of.digest
    assert "quiet" in card["held_out"]
    entropy = made_of.config["entropy"]
    assert card["decided_on"] == [[entropy, f"dataset-{part}"] for part in ("train", "validation")]
    assert list(score_non_learned(made_of, made_of.episodes("test"), OFTEN)) == ["snapshot_chi2"]
    world = setup().copy_with(detector=make_detector({"name": str(file), "threshold": 0.5}))
    seeds = seeds_of_runs(0, "training", world.name, range(4))
    start = WarmStart(world, make_generators(seeds), threads=1)
    runs = {name: play(start, {"name": name}) for name in ("none", "ramp")}
    assert (compute_displacement(world, runs["ramp"], runs["none"]) >= 0.0).all()
    assert (runs["ramp"].peak > runs["none"].peak).any()


def test_in_the_loop_it_says_what_it_said_of_the_data(file, trainer):
    """Float16 apart: the same runs again, judged epoch by epoch by the file."""
    trainer.restore(file.parent / CHECKPOINT)
    trainer.network.load_state_dict(trainer.best_weights)
    found = trainer.data.episodes("validation")
    with torch.no_grad():
        seen = torch.from_numpy(found.observation[::2].astype(np.float32))
        wanted = module.compute_statistic(trainer.network.log_odds(seen).numpy())
    world = setup().copy_with(detector=make_detector({"name": str(file), "threshold": 0.999}))
    simulator = world.simulator(8, lambda work, n: work(0, n))
    simulator.start_episodes(
        make_generators(seeds_of_runs(0, "dataset-validation", world.name, range(8)))
    )
    simulator.run_filter_only(world.filter_only)
    for k in range(world.live + world.steps):
        verdict = simulator.step(attacked=False)
        now = 0.999 * verdict.statistic[:, 0] / verdict.threshold[:, 0]
        np.testing.assert_allclose(now, wanted[:, k], atol=0.02)


def test_a_killed_training_comes_to_the_same_result(data, file, trainer, tmp_path, monkeypatch):
    learn = Trainer.learn

    def until_killed(self, episodes):
        if self.done == 2:
            raise KeyboardInterrupt
        return learn(self, episodes)

    given = arguments(data, tmp_path / "guard")
    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "learn", until_killed)
        with pytest.raises(KeyboardInterrupt):
            train(given, QUIET)
    monkeypatch.setattr(module, "_export", lambda trainer, console: trainer)
    again = train(given, QUIET)
    trainer.restore(file.parent / CHECKPOINT)
    assert (again.done, again.best, again.best_pass) == (3, trainer.best, trainer.best_pass)
    for name, weight in trainer.best_weights.items():
        assert torch.equal(again.best_weights[name], weight)
    mine, theirs = (
        [{**line, "wall_s": 0} for line in read_record(path / RECORD)]
        for path in (file.parent, given.out)
    )
    assert mine == theirs
    (given.out / CHECKPOINT).write_bytes(b"no checkpoint")
    with pytest.raises(ValueError, match=r"checkpoint\.pt is damaged, .*: remove it"):
        train(given, QUIET)


def test_minibatches_begin_at_drawn_moments_before_the_onset(trainer, monkeypatch):
    """Else a network that remembers could count the epochs to the onset of all attacks."""
    begins, lengths = [], []
    loss, log_odds = trainer._loss, trainer.network.log_odds

    def noted(some, begin):
        begins.append(begin)
        return loss(some, begin)

    def measured(seen):
        lengths.append(seen.shape[1])
        return log_odds(seen)

    monkeypatch.setattr(trainer, "_loss", noted)
    monkeypatch.setattr(trainer.network, "log_odds", measured)
    for _ in range(5):
        trainer.learn(trainer.data.episodes("train"))
    epochs = trainer.config["epochs"]
    least = 2.0 / trainer.config["interval_s"]
    assert len(set(begins)) > 5
    assert 0 <= min(begins) <= max(begins) <= epochs["live"] - least
    assert lengths == [epochs["all"] - begin for begin in begins]
    # the loss from a later moment is that of episodes cut there
    episodes = trainer.data.episodes("train")
    late = loss(episodes, 7)
    assert not torch.equal(late, loss(episodes, 0))
    cut = [part[:, 7:] if part.ndim > 1 else part for part in episodes]
    shorter = Episodes(*cut)._replace(epochs=episodes.epochs - 7)
    assert torch.equal(late, loss(shorter, 0))


def test_drawn_ages_are_cut_at_a_drawn_time_before_each_onset(tmp_path):
    """And so small a set is enough for a window network to be trained and written."""
    drawn = {"turn_on": "drawn", "age_s": (15.0, 60.0)}
    shift = {"name": "filter-shift", "detector": {"name": "solution-separation"}}
    world = World.of(scenario="zhong2025", timeline=TIMES, domain=drawn).setup
    runs = {"train": 8, "validation": 8, "test": 8}
    plan = Plan(world, length_m=10.0, terms=(shift,), runs=runs)
    run_experiment(plan, Store(tmp_path / "aged"), threads=1)
    data = load_dataset(tmp_path / "aged")
    episodes, config = data.episodes("train"), data.config
    window = config["epochs"]["steps"] + config["epochs"]["hold"]
    live = episodes.epochs - window
    before = int(np.sort(live)[len(live) // 2]) + 1
    assert live.min() < before < live.max()
    cut = module.cut_episodes(episodes, before, config)
    assert cut.attack.shape[1] == before + window
    for row, (old, new) in enumerate(zip(episodes.epochs, cut.epochs, strict=True)):
        assert new == min(old, before + window)
        for name in ("observation", "attack", "displacement_m"):
            mine, whole = getattr(cut, name)[row], getattr(episodes, name)[row]
            np.testing.assert_array_equal(mine[:new], whole[old - new : old])
        assert not cut.attack[row, new:].any()
    settings = {"network": "window", "past_s": 20.0, "passes": 2}
    made = train(arguments(tmp_path / "aged", tmp_path / "guard", **settings), QUIET)
    assert make_detector({"name": str(made), "threshold": 0.9}).detector.card.state[0].size > 0
    with pytest.raises(ValueError, match="`past_s` must be a number of at least 2"):
        arguments(tmp_path / "aged", tmp_path / "guard", past_s=1.0)


def test_what_follows_an_episode_counts_for_nothing(tmp_path):
    world = World.of(
        scenario="zhong2025", timeline=TIMES, domain={"turn_on": "drawn", "age_s": (15.0, 60.0)}
    ).setup
    terms = ("innovation", "in-view", "line-of-sight", "chi-square")
    plan = Plan(world, length_m=10.0, terms=terms, runs={"train": 8})
    run_experiment(plan, Store(tmp_path / "aged"), threads=1)
    data = load_dataset(tmp_path / "aged")
    episodes, found = data.episodes("train"), []
    after = ~episodes.valid
    assert len(np.unique(episodes.epochs)) > 4
    spoiled = episodes._replace(observation=episodes.observation.copy())
    spoiled.observation[after] = 300.0
    for each in (episodes, spoiled):
        made = Trainer(arguments(tmp_path / "aged", tmp_path / "guard"), data)
        made.normalize(each)
        loss = made._loss(each, 3)
        loss.backward()
        gradients = [weight.grad for weight in made.network.parameters()]
        found.append([loss, *gradients, torch.tensor(made.score(each))])
    for mine, theirs in zip(*found, strict=True):
        np.testing.assert_array_equal(mine.detach(), theirs.detach())


def test_the_best_is_kept_where_training_diverges(data, trainer, tmp_path, monkeypatch):
    validation, network = trainer.data.episodes("validation"), trainer.network
    assert np.isfinite(trainer.score(validation).loss)
    with monkeypatch.context() as patch:
        patch.setattr(network, "log_odds", lambda seen: torch.full(seen.shape[:2], torch.inf))
        found = trainer.score(validation)
    assert found.loss == np.inf
    trainer.keep(found.loss)
    assert not trainer.best_weights
    loss, good = Trainer._loss, 1

    def broken(self, *given):
        return loss(self, *given) * (np.nan if self.done == good else 1.0)

    monkeypatch.setattr(Trainer, "_loss", broken)
    console = Console(record=True, quiet=False, width=200, file=StringIO())
    with monkeypatch.context() as patch:
        patch.setattr(module, "_export", lambda trainer, console: trainer.best_pass)
        assert train(arguments(data, tmp_path / "kept"), console) == 1
    assert "pass 2 diverged" in console.export_text()
    good = 0
    with pytest.raises(ValueError, match="nothing to keep"):
        train(arguments(data, tmp_path / "none"), QUIET)


def test_what_does_not_fit_is_refused_before_anything_is_written(data, file, tmp_path, monkeypatch):
    monkeypatch.setattr(Trainer, "learn", None)
    given = arguments(data, file.parent)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("keep")
    copy = shutil.copytree(data, tmp_path / "copy")
    next(copy.glob("cells/test-*.npz")).unlink()
    for changes, message in (
        ({"width": 9}, r"other results.*width: 8, not 9"),
        ({"out": tmp_path / "other"}, "not empty"),
        ({"out": tmp_path / "few", "false_alarms_per_hour": 0.2}, "part validation: 0.2 false"),
        ({"data": copy, "out": tmp_path / "late"}, r"test-\d+\.npz is missing"),
    ):
        with pytest.raises(ValueError, match=message):
            train(replace(given, **changes), QUIET)
    with monkeypatch.context() as patch:  # fewer in one part
        rows = {"validation": 300, "test": 100, "train": 9}
        clean = lambda _, part: SimpleNamespace(clean=np.ones(rows[part], dtype=bool))  # noqa: E731
        patch.setattr(Dataset, "episodes", clean)
        with pytest.raises(ValueError, match=r"part test: 0\.5 false .*100 clean runs are too few"):
            train(replace(given, out=tmp_path / "few", false_alarms_per_hour=0.5), QUIET)
    assert {path.name for path in tmp_path.iterdir()} == {"other", "copy"}  # names are still free
    for bad in ({"passes": 0}, {"learning_rate": 0.0}, {"seed": -1}, {"out": Path("a b")}):
        with pytest.raises(ValueError, match=f"`{next(iter(bad))}`"):
            replace(given, **bad)
    words = ["detector", "--data", str(tmp_path / "no"), "--out", str(tmp_path / "guard")]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit, match=r"^error: [^\n]*no[^\n]*$"):
        module.main()


MOVED = np.tile([0.0, 1.0, 2.0, 3.0, 4.0, 4.0], (9, 1))


def made_up(clean, attacked):
    """Episodes of one epoch of warm-up, four of attack and one of hold."""
    statistic, displacement = np.zeros((18, 6)), np.zeros((18, 6), dtype=np.float32)
    statistic[::2], statistic[1::2], displacement[1::2] = clean, attacked, MOVED
    attack = np.zeros((18, 6), dtype=np.bool_)
    attack[1::2, 1:] = True
    nothing, epochs = np.zeros(18), {"steps": 4, "hold": 1}
    length = np.full(18, 6)
    clean = np.tile([True, False], 9)
    found = Episodes(nothing, attack, displacement, clean, *[nothing] * 5, length)
    return statistic, found, {"epochs": epochs, "interval_s": 36.0, "length_m": 3.0}


def test_a_score_is_displacement_before_an_alarm_and_the_smooth_loss_where_odds_are_sharp():
    clean, attacked = np.zeros((9, 6)), np.zeros((9, 6))
    clean[:, 3] = np.arange(1.0, 10.0)  # maxima 1 to 9
    attacked[:8, 4] = 20.0  # an alarm at the fourth epoch after the onset, but for the last run
    # a run in five may alarm: one of nine does, and the next would with 2 of 10
    rate = -np.log(0.8) * 20.0
    found = score_statistic(*made_up(clean, attacked), rate)
    assert found.threshold == 8.0
    assert found.counted == 8  # one twin is above it
    # alarms come an epoch of hold after what counts: 2 m
    assert (found.mean_m, found.loss) == (pytest.approx(2.0), pytest.approx(2.0 / 3.0))
    clean[:, 0] = 30.0  # in the warm-up, where it decides nothing but which runs count
    attacked[:, 0] = 30.0
    nobody = score_statistic(*made_up(clean, attacked), rate)
    assert (nobody.threshold, nobody.counted, nobody.loss) == (8.0, 0, 1.0)
    clean, attacked = np.zeros((9, 6)), np.zeros((9, 6))
    clean[0, 3] = 1.0  # one in twenty of nine: the largest is the threshold
    attacked[:5, 3] = 2.0  # an alarm at the third epoch of the attack, with one of hold
    statistic, found, config = made_up(clean, attacked)
    odds = torch.tensor(1000.0 * statistic, requires_grad=True)
    parts = torch.from_numpy(found.displacement_m / 3.0).clamp(max=1.0)
    of_clean = torch.from_numpy(found.clean)
    # one metre of three in five runs, all of it in four
    live, epochs = torch.ones(18, dtype=torch.long), config["epochs"]
    loss = compute_undetected(odds, parts, of_clean, live, epochs)
    assert loss.item() == pytest.approx((5 / 3 + 4) / 9)
    compute_undetected(odds / 1000.0, parts, of_clean, live, epochs).backward()
    assert odds.grad is not None
    assert (odds.grad[~of_clean, 1:] <= 0.0).all()  # alarms do good
    assert (odds.grad[of_clean] >= 0.0).all()
