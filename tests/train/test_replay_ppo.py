"""Receivers on linear replay beside those of the engine, and a training on them."""

import json

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "tyro"):
    pytest.importorskip(name)

from spoofgym.bench.runs.play import WarmStart, induced_error, make_bound_spoofer, play
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.record import undetected_displacement
from spoofgym.bench.runs.world import World
from spoofgym.bench.search.open_loop import QUICK
from spoofgym.limits.response import Replay
from spoofgym.simulation.setup import seeds_of_runs
from spoofgym.spoofers.learned import ModelPolicy, OnnxPolicy
from spoofgym.spoofers.scaled import Scaled
from spoofgym.tasks import get_task
from train import replay_bank, replay_ppo
from train.replay_bank import (
    SEEN,
    Bank,
    BankBackend,
    BankRuns,
    BankVecEnv,
    Course,
    Receivers,
    draw_circumstances,
    record_bank,
)
from train.replay_ppo import Settings, build_table, correct_nothing, list_plan
from train.suite_ppo import make_env

TIMES = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 30.0, "time_to_alert_s": 5.0}
PLACE = {
    "scenario": "zhong2025",
    "timeline": TIMES,
    "decision_interval_s": 3.0,
    "between": "linear",
}
GUARD = {
    "name": "solution-separation",
    "longest_s": 20.0,
    "spacing_s": 5.0,
    "thresholds": "nominal",
}
BASE = {"name": "open-loop", "rates_mps": [0.0, 0.3, 0.5]}
RUNS, ENTROPY = 6, 3


@pytest.fixture(scope="module")
def world():
    return World.of(None, **PLACE)


@pytest.fixture(scope="module")
def bank(world):
    return record_bank(world, GUARD, "training", ENTROPY, RUNS)


@pytest.fixture(scope="module")
def course(world):
    return Course.of(world.setup, make_env(BASE, "statistics")["action"])


def draw_recorded(setup):
    """Circumstances of the runs, and their order in the bank."""
    given = draw_circumstances(setup, ENTROPY, RUNS)
    return given, np.lexsort((given["world"], given["start_s"], given["age_s"]))


def correct(seen):
    """A correction that depends on all that is seen."""
    wave = 3.0 * seen[:, 0] - seen[:, 1] + np.sin(9.0 * seen[:, 2]) + 2.0 * seen[:, 4]
    return np.tanh(wave)[:, None]


@pytest.mark.parametrize("amplitude", [0.3, 0.5, 1.0])  # quiet, some alarms, alarms
def test_a_policy_is_shown_and_reaches_what_it_does_on_the_engine(world, bank, course, amplitude):
    assert len(bank.sky) == RUNS  # all of them count
    env = make_env(BASE, "statistics")
    columns, shown = None, []

    def act(seen):
        shown.append(seen[:, columns])
        return correct(shown[-1])

    policy = Scaled(ModelPolicy(act, label="wave", **env), amplitude)
    entry = specify_detector(GUARD)
    setup = world.build_setup(entry)
    names = make_bound_spoofer(policy, setup, 1)[1].names
    columns = [names.index(name) for name in SEEN]
    given, order = draw_recorded(setup)
    given = {name: values[order] for name, values in given.items()}
    generators = [world.generators(ENTROPY, "training", RUNS)[k] for k in order]
    start = WarmStart(setup, generators, threads=1, given=given)
    attacked, clean = play(start, policy), play(start, "none")
    played = BankRuns(bank, course, correct).run(amplitude, np.arange(RUNS))
    error = induced_error(setup, attacked, clean)[: setup.steps]
    reached = undetected_displacement(error, attacked.first_alarm, setup.hold)
    first = Receivers(bank, course, RUNS)
    first.start(np.arange(RUNS), np.arange(RUNS))
    np.testing.assert_allclose(first.observe(), shown[0], rtol=1e-4, atol=1e-6)
    assert (shown[0][:, -1] > 0.0).all()  # as at the end of the warm-up
    np.testing.assert_array_equal(played.first_alarm > 0, attacked.first_alarm > 0)
    assert np.abs(played.first_alarm - attacked.first_alarm).max() <= 1
    assert (amplitude > 0.3) == (attacked.first_alarm > 0).any()
    alike = played.first_alarm == attacked.first_alarm
    np.testing.assert_allclose(played.undetected_m()[alike], reached[alike], rtol=0.02, atol=0.05)


def test_an_open_loop_attack_is_judged_as_by_the_replay_it_was_recorded_from(world, bank, course):
    setup = world.setup
    given, order = draw_recorded(setup)
    seeds = seeds_of_runs(ENTROPY, "training", setup.name, range(RUNS))
    replay = Replay(setup, [world.judge(specify_detector(GUARD))], seeds, threads=1, given=given)
    curves = np.array([np.linspace(0.1, 0.6, 10), np.linspace(0.5, -0.5, 10) ** 2])
    found = replay.play(0, curves)
    peak, reach = BankBackend(bank, course).play(curves, np.arange(RUNS))
    np.testing.assert_allclose(peak, found.peak[:, order], rtol=1e-3)
    expected = found.error[: replay.attack_epochs].max(axis=0).mean(axis=1)
    np.testing.assert_allclose(reach, expected, rtol=1e-3)


def test_a_training_on_long_attacks_judges_one_epoch_of_several(bank, course, monkeypatch):
    monkeypatch.setattr(replay_bank, "JUDGED", 20)
    few, thinned = course.thin(bank)
    assert thinned.every == 2
    assert few.clean.shape[1] == bank.clean.shape[1] // 2
    everyone = np.arange(RUNS)
    own = BankRuns(few, thinned, correct).run(0.3, everyone)
    whole = BankRuns(bank, course, correct).run(0.3, everyone)
    np.testing.assert_allclose(own.observe(), whole.observe(), rtol=1e-5)
    np.testing.assert_allclose(own.rates, whole.rates, rtol=1e-5)
    np.testing.assert_allclose(own.undetected_m(), whole.undetected_m(), rtol=0.02)
    assert BankVecEnv(bank, course, 4, 25.0, 1, blind=True).receivers.course == thinned


@pytest.mark.parametrize("size", [0.02, 1.0])
def test_rewards_of_an_episode_are_its_undetected_displacement_and_the_price(bank, course, size):
    loud = course._replace(base=np.where(np.arange(course.decisions) > 1, size, 0.01))
    envs = BankVecEnv(bank, loud, 4, 25.0, 1, blind=True)
    seen, paid = envs.reset(), np.zeros(4)
    assert seen.shape == (4, 4)  # without the statistic
    for _ in range(loud.decisions):
        seen, reward, over, infos = envs.step(np.zeros((4, 1)))
        paid += reward
        if over.all():
            break
    rows = envs.receivers.row  # of the episodes that follow; all runs end alike here
    alarmed, moved = BankRuns(bank, loud, correct_nothing).play(1.0)
    assert alarmed.all() == (size > 0.5)
    assert alarmed.any() == (size > 0.5)  # the small one comes to its end
    assert "terminal_observation" in infos[0]
    ends = moved["undetected_displacement_m"] - 25.0 * alarmed
    assert np.all([np.isclose(each, ends, atol=1e-3).any() for each in paid])
    assert rows.max() < RUNS
    envs.close()


@pytest.mark.nightly
def test_a_training_ships_what_acts_as_it_did_and_goes_on(tmp_path, monkeypatch, world):
    monkeypatch.setattr(replay_ppo, "SHIPPED", tmp_path / "agents")
    monkeypatch.setattr(replay_ppo, "SCORES", tmp_path / "scores.json")
    monkeypatch.setattr(replay_ppo, "TASKS", {"S1": (192, 64, 0.1)})
    monkeypatch.setattr(replay_ppo, "LONG", QUICK)
    monkeypatch.setattr(replay_ppo, "make_world", lambda task: world)
    monkeypatch.setattr(replay_ppo, "make_detector", lambda task, case: GUARD)
    scored = {"score": {}, "runs": 64}
    monkeypatch.setattr(replay_ppo, "score_policy", lambda path, runs: scored)
    sizes = {"episodes": 64, "checkpoints": 2, "num_envs": 8, "seeds": (0,)}
    settings = Settings(out=tmp_path / "runs", tasks=("S1",), ship=True, **sizes)
    kept = {}
    whole = replay_ppo.write_policy

    def write(out, task, case, base, policy, row):
        kept[row["seed"], row["knowledge"]] = policy
        return whole(out, task, case, base, policy, row)

    monkeypatch.setattr(replay_ppo, "write_policy", write)
    found = replay_ppo.play(settings)
    row = found["S1 own-filter statistics 0"]
    assert row["choice_m"][0] == found["S1 own-filter base"]["choice_m"] > 0.0
    assert row["checkpoint"] == int(np.argmax(row["choice_m"]))
    assert "S1 | own-filter | statistics" in build_table(found)
    again = dict(found)
    monkeypatch.setattr(replay_ppo, "train", None)  # it is finished
    assert replay_ppo.play(settings) == again
    assert json.loads((tmp_path / "scores.json").read_text()) == found
    for (seed, sees), policy in kept.items():
        blind = "-blind" if sees == "blind" else ""
        file = tmp_path / "agents" / f"s1-own-filter{blind}-{seed}.onnx"
        shipped = OnnxPolicy(str(file))
        names = shipped.card.observation.names
        columns = [names.index(name) for name in SEEN[: len(SEEN) - (sees == "blind")]]
        seen = np.random.default_rng(1).uniform(0.0, 1.0, (5, len(names))).astype(np.float32)
        expected = policy.act(seen[:, columns])
        np.testing.assert_allclose(shipped.model.act(seen), expected, atol=1e-5)
        assert shipped.card.training["decided_on"] == [[replay_ppo.LEARNING, "training"]]


def test_a_file_that_another_training_wrote_is_refused(tmp_path):
    path = tmp_path / replay_ppo.POLICIES / "s1-own-filter-0.onnx"
    path.parent.mkdir()
    path.write_bytes(b"another")
    with pytest.raises(ValueError, match="is not the file that this training wrote"):
        replay_ppo.find_policy(tmp_path, {"file": path.name, "sha256": "0" * 64})


def test_what_ships_is_what_is_stored():
    stored = json.loads(replay_ppo.SCORES.read_text())
    rows = [each for each in stored.values() if each and each.get("sha256")]
    shipped = {path.name for path in replay_ppo.SHIPPED.glob("*.onnx")}
    assert shipped == {row["file"] for row in rows}
    for row in rows:
        path = replay_ppo.SHIPPED / row["file"]
        card = OnnxPolicy(str(path)).card
        assert replay_ppo.compute_file_digest(path) == row["sha256"] == card.file.sha256
        assert card.training["choice_m"] == row["choice_m"]
        assert card.training["decided_on"] == [[replay_ppo.LEARNING, replay_ppo.TRAINED]]
        assert row["ratio"]["high"] >= 0.97  # its interval does not lie below
    averaged = [
        row["averaged"]["value"] / row["ratio"]["value"] for row in rows if "averaged" in row
    ]
    assert max(averaged) < 1.0  # without its own run's statistic each gets less far


def test_the_plan_says_what_is_trained_and_bad_names_what_is_valid():
    (line,) = list_plan(Settings(tasks=("S2",)))
    assert line.startswith("S2: 6 trainings, about ")  # five seeds, and one blind
    for word, given, valid in (
        ("tasks", "S4", "S1, S2, S3"),
        ("tasks", "S1:long", "as in S1:60"),
        ("detectors", "ewma", "own-filter, same-filter"),
        ("knowledge", "all", "blind, statistics"),
    ):
        with pytest.raises(ValueError, match=f"'{given}'.*{valid}"):
            Settings(**{word: (given,)})


@pytest.mark.parametrize(("name", "steps"), [("S1", 300), ("S1:60", 120)])
def test_a_task_can_have_attacks_of_another_duration(name, steps):
    world, whole = replay_ppo.make_world(name), World.of("S1")
    assert world.setup.steps == steps
    assert world.settings["domain"] == whole.settings["domain"]
    assert replay_ppo.make_detector(name, "own-filter") == get_task("S1").detector


def test_a_bank_keeps_the_runs_that_are_taken():
    empty = np.zeros((3, 2, 2), dtype=np.float32)
    units, moved = np.zeros((1, 2, 2, 1)), np.zeros((1, 2, 2, 1))
    bank = Bank(empty, units, moved, np.zeros(3, dtype=int), np.arange(3), np.arange(3) / 4)
    some = bank.take(np.array([True, False, True]))
    assert some.sky.tolist() == [0, 2]
    assert some.onset_ratio.tolist() == [0.0, 0.5]
