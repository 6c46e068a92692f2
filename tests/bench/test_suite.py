"""What a campaign runs, where, and where its chance comes from; the standard suite."""

import json
from functools import cache, partial
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from spoofgym.bench.experiments import suite as standard
from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.report.campaign import shorten_label
from spoofgym.bench.runs.players import DEFAULT_DETECTORS
from spoofgym.bench.runs.world import PLAIN_ID, World
from spoofgym.bench.search.amplitude import Tuning
from spoofgym.bench.search.attack_suite import Selection
from spoofgym.cli import app
from spoofgym.core.settings import compute_digest
from spoofgym.detectors import DETECTORS, Shewhart
from spoofgym.simulation.setup import SPLITS, seeds_of_runs
from spoofgym.tasks import DEFAULT_TASK, get_task

from .support import small_suite

TIMES = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 2.0}


def words(*given):
    return [tuple(seed.generate_state(4).tolist()) for seed in seeds_of_runs(*given)]


def test_runs_share_no_noise_between_splits_scenarios_runs_and_campaigns():
    found = {
        word
        for entropy in (0, 1)
        for split in SPLITS
        for scenario in ("zhong2025", "groves")
        for word in words(entropy, split, scenario, range(5))
    }
    assert len(found) == 2 * len(SPLITS) * 2 * 5
    # more runs begin with the same ones
    few, many = (words(3, "evaluation", "zhong2025", range(runs)) for runs in (4, 9))
    assert many[:4] == few


def test_spoofers_that_ignore_a_drawn_target_are_warned_of_and_oracles_refused():
    drawn = {"target_heading_deg": "random", "detectors": ("never",)}
    with pytest.warns(
        UserWarning, match=r"heading: Ramp \(heading_deg=90\), Step \(heading_deg=90\);"
    ):
        small_suite(spoofers=("ramp", "step"), **drawn).check_fit()
    small_suite(spoofers=({"name": "step", "heading_deg": "target"},), **drawn).check_fit()
    assert not any(DETECTORS[spec["name"]].oracle for spec in DEFAULT_DETECTORS)
    oracles = ("ewma", {"name": "oracle-ramp", "rate_mps": 0.2})
    with pytest.raises(ValueError, match=r"oracle-ramp\(rate_mps=0.2\): an oracle knows the"):
        Suite(env=PLAIN_ID, detectors=oracles)
    suite = Suite(env=PLAIN_ID, detectors=oracles, allow_oracles=True)
    note = "oracle-ramp(rate_mps=0.2) is an oracle: it knows the attack"
    assert [each for each in suite.config["notes"] if "an oracle" in each] == [note]
    plain = [small_suite(allow_oracles=allow).digest for allow in (True, False)]
    assert plain[0] == plain[1]


def test_the_digest_follows_everything_that_results_depend_on():
    digests = [
        small_suite(**changes).digest
        for changes in (
            {},
            {"runs": 6},
            {"entropy": 1},
            {"scenario": "groves"},
            {"attack": {"name": "false-position", "coherent": False}},
            {"detectors": ("ewma",)},
            {"spoofers": ("step",)},
            {"tuning": Tuning(budget=0.1)},
            {"selection": Selection(runs=7)},
            {"floor": {"floor_m": {}, "assumptions": []}},
        )
    ]
    assert len(set(digests)) == len(digests)
    # neither a default that is written out nor NumPy's numbers change anything
    written_out = ("snapshot-chi2", {"name": "ewma", "smoothing": 0.1})
    tuning = Tuning(budget=0.1, runs=np.int64(Tuning.runs))
    for n, changes in (
        (0, {"detectors": written_out}),
        (1, {"runs": np.int64(6)}),
        (2, {"entropy": np.int64(1)}),
        (7, {"tuning": tuning}),
    ):
        assert compute_digest(small_suite(**changes).config) == digests[n]
    own, keyword = small_suite(), small_suite(settings={"imu_rate_hz": 20})
    mapping = small_suite(scenario={"name": "zhong2025", "imu_rate_hz": 20})
    assert "imu_rate_hz" not in own.config["scenario"]
    assert keyword.config["scenario"]["imu_rate_hz"] == 20
    assert keyword.config["scenario"]["name"] == "zhong2025@20Hz"
    assert keyword.digest == mapping.digest != own.digest


def test_a_campaign_has_its_world_and_its_runs_and_plays_the_clean_twin_first():
    assert World.of("T3") == World(settings=get_task("T3").world_kwargs)
    named = World.of(env=PLAIN_ID, timeline=TIMES, between="hold", scenario=None)
    assert named == World.of(env=PLAIN_ID, timeline=TIMES, settings={"between": "hold"})
    assert named.copy_with(between="ramp").settings == {"timeline": TIMES, "between": "ramp"}
    assert World.of().config == World.of(DEFAULT_TASK).config
    assert World.of(scenario="trolley").env == PLAIN_ID  # all else has the class's defaults
    assert Suite(detectors=["never"], spoofers=["none"]).world == World.of()
    suite = small_suite(timeline=TIMES, entropy=3)
    world = World.of(env=PLAIN_ID, timeline=TIMES)
    assert {name: suite.config[name] for name in world.config} == world.config
    one, few = world.generators(3, "training", 3, first=2), suite.generators("training", 3)
    assert one[0].random() == few[2].random()
    suite = small_suite(spoofers=("step", "none"))
    assert [entry.label for entry in suite.spoofer_players] == ["none", "step"]


@pytest.mark.parametrize(
    ("make", "given", "message"),
    [
        (partial(Suite, env=PLAIN_ID), {"detectors": ()}, "at least one detector"),
        (partial(Suite, env=PLAIN_ID), {"detectors": ("ewma", "ewma")}, "listed twice: ewma"),
        (Tuning, {"runs": 58}, r"`runs` must be at least 59 for a budget of 0.05: .* 58"),
        (World.of, {"env": "T3"}, "unknown environment 'T3'"),
        (partial(World.of, "T3"), {"env": "x", "scenario": "y"}, "`env`, `scenario` can't be"),
        (World.of, {"attack": "quiet", "settings": {"attack": "quiet"}}, "given by name, too"),
    ],
)
def test_what_is_no_suite_or_world_is_refused(make, given, message):
    with pytest.raises(ValueError, match=message):
        make(**given)


SMALL = "--set", "domain={}"
"""One world in place of many, for what no world has a part in."""


class Mine(Shewhart):
    """Somebody's own detector."""


@cache
def played(*options):
    """The suite that a command line would play; the world of the default task takes seconds."""
    found = []

    def stop(suite, *_):
        found.append(suite)
        raise SystemExit

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("spoofgym.cli.bench"), "calibrate_suite", stop)
        result = CliRunner().invoke(app, ["bench", *options])
    assert found, result.output
    return found[0]


def test_bench_plays_in_the_world_of_the_task_at_one_rate_and_the_controls_with_it():
    suite, task = played(), get_task(DEFAULT_TASK)
    assert {name: suite.world.settings[name] for name in task.world_kwargs} == task.world_kwargs
    assert suite.alert_limit_m == (task.alert_limit_m or Suite.alert_limit_m)
    specs = [entry.spec for entry in suite.detector_players]
    names = [spec["name"] for spec in specs]
    assert names[:4] == ["never", "lottery", "solution-separation", "solution-separation"]
    assert [spec.get("filter") for spec in specs[2:4]] == ["augmented", None]
    assert (task.detector | {"false_alarms_per_hour": standard.RATE}).items() <= specs[2].items()
    rates = [spec for spec in specs if spec.get("signals") == "range_rate"]
    assert [spec["name"] for spec in rates] == list(standard.RATE_TESTS)
    assert names[8:] == list(standard.TESTS)
    assert {spec.get("false_alarms_per_hour") for spec in specs[1:]} == {standard.RATE}
    labels = [e.spec.get("label") or e.spec["name"] for e in suite.spoofer_players[1:]]
    assert labels == list(standard.SPOOFERS)
    assert all(entry.tuned for entry in suite.spoofer_players[1:])
    # the campaign of the stored headlines
    stored = json.loads((Path(standard.__file__).parents[3] / "docs/headlines.json").read_text())
    names = [row["detector"] for row in stored["worlds"][DEFAULT_TASK]["detectors"]]
    assert [shorten_label(entry.label) for entry in suite.detector_players] == names
    # named ones play with the controls
    named = ["ewma", "tests.bench.test_suite:Mine"]
    suite = played(*(word for name in named for word in ("--detector", name)))
    specs = [entry.spec for entry in suite.detector_players]
    assert [spec["name"] for spec in specs] == ["never", "lottery", *named]
    assert {spec.get("false_alarms_per_hour") for spec in specs[1:]} == {standard.RATE}


def test_a_budget_scales_everything_and_sizes_come_before_it():
    def sizes(*options):
        suite = played(*options)
        tuning, selection = suite.tuning, suite.selection
        chosen = selection and selection.runs
        return suite.runs, tuning.runs, chosen, tuning.quick, suite.floor_worlds

    assert sizes() == standard.BUDGETS["standard"]
    assert sizes(*SMALL, "--budget", "quick") == standard.BUDGETS["quick"]
    assert all(np.diff([each[:3] for each in standard.BUDGETS.values()], axis=0).ravel() >= 0)
    given = ["--runs", "40", "--selection-runs", "0", "--training-runs", "60"]
    assert sizes(*SMALL, "--budget", "full", *given) == (40, 60, None, False, None)
    assert played(*SMALL, "--budget", "quick").tuning.as_dict()["quick"]
    assert "quick" not in played().tuning.as_dict()  # as it was before budgets
