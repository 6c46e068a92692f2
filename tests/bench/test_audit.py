"""Audits: every warning has a detector that earns it, and a good one earns none."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import spoofgym
from spoofgym.bench.experiments import audit_worlds as module
from spoofgym.bench.experiments.audit import Auditor
from spoofgym.bench.experiments.audit_cells import BUDGETS, AuditCells
from spoofgym.bench.experiments.runner import run_experiment
from spoofgym.bench.experiments.store import Store
from spoofgym.bench.report.audit import LINES, WIDTH, format_screen
from spoofgym.bench.report.detector_page import replay_worst_attack, write_score_verdict
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.record import MEASURES, Aim, Protection, Winner
from spoofgym.bench.scores.audit import AgeProbe, Audit
from spoofgym.bench.scores.detector import CLEAN, WINDOW, DetectorScore, FamilyScore
from spoofgym.bench.scores.scores import SHARES
from spoofgym.bench.scores.statistics import bootstrap_mean, draw_resamples
from spoofgym.detectors import Calibrated, Never, Raim, Verdict
from spoofgym.limits.bounds import draw_worlds, zero_alarm_bounds
from spoofgym.limits.no_alarm import EXCLUDES, OPEN_LOOP_NOTE
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.tasks import EVENTS

from ..command_line import refused
from ..outside.detectors import AverageRate, BlindAfterFiveMinutes, GrowingThreshold
from .detector_support import SmallTask, small_task

RUNS, LIMIT = 100, 2.0
SOON = {"gain": 0.03, "limit": 0.4}
"""For attacks of 20 s."""


class AgedTask(SmallTask):
    @property
    def world_kwargs(self):
        world = super().world_kwargs
        return {**world, "domain": {**world["domain"], "age_s": [20.0, 60.0]}}


class Whim(AverageRate):
    """What it says depends on how often it has been called."""

    gain, limit, calls = 0.03, 0.4, 0

    def look(self, statistic, age_s):
        Whim.calls += 1
        return statistic * (1.0 + 1e-4 * Whim.calls)


@pytest.fixture
def probe(monkeypatch):
    monkeypatch.setattr(module, "AGES_S", (20.0, 80.0, 320.0))
    of = small_task()
    auditor = Auditor(
        AgedTask("aged", of.title, of.task, of.families), "quick", entropy=0, threads=1
    )
    return lambda judge: auditor.worlds.probe_ages(judge, 24, 3)


def soon(kind, **more):
    return type(kind.__name__, (kind,), {**SOON, **more})()


def test_a_good_detector_finds_an_attack_at_any_age(probe):
    found = probe(Calibrated(soon(AverageRate), 1.0))
    assert found.alike
    assert [*found.warn()] == []
    assert 0.2 < found.share.mean() < 0.8
    assert found.counts.mean() > 0.9
    assert (found.missed <= found.crossed).all()
    assert json.loads(json.dumps(found.as_dict(), allow_nan=False))["age_s"] == [20.0, 80.0, 320.0]


def test_one_that_goes_blind_is_named_with_the_time(probe):
    (text,) = probe(soon(BlindAfterFiveMinutes, sees_for_s=150.0)).warn()
    assert text.startswith("goes blind between 1 min and 5 min after switch-on: it finds ")
    assert ", 0 % after 5 min" in text


@pytest.mark.parametrize(("doubles_after_s", "words"), [(30.0, "goes blind"), (80.0, "finds less")])
def test_one_whose_threshold_grows_is_named_with_its_growth(doubles_after_s, words, probe):
    found = probe(soon(GrowingThreshold, doubles_after_s=doubles_after_s))
    (text,) = found.warn()
    assert text.startswith(words)
    grown = found.threshold[-1] / found.threshold[0]
    assert f"as its threshold grows, {grown:.1f}-fold by then" in text
    live_s = 310.0, 10.0
    ends = (1.0 + each / doubles_after_s for each in live_s)
    assert grown == pytest.approx(next(ends) / next(ends))


def test_one_that_says_another_thing_of_the_same_epochs_is_found_out(probe):
    assert not probe(Whim()).alike


def family(key, *displacements, silent=True):
    """Attacks of a family: the worst that is looked for, and one that was found elsewhere."""
    aims = (*(Aim(MEASURES[0], share) for share in SHARES), Aim(MEASURES[0], limit_m=LIMIT))
    spec = {"name": "ramp", "rate_mps": 1.0}
    winners = []
    for letter, moved in zip("ct", displacements, strict=False):
        each = {MEASURES[0]: np.broadcast_to(np.asarray(moved, dtype=float), RUNS).copy()}
        winners.append(Winner(letter, "ramp", "rate_mps", 1.0, spec, aims, each))
    runs = np.full(RUNS, silent), np.arange(RUNS) % 16, None
    return FamilyScore(key, False, LIMIT, Protection({}, tuple(winners), *runs))


def audit_of(*families, alarms=0.0, found=0.5, **more):
    """An audit with figures that are given; `alarms`: part of the runs without an attack."""
    quiet = np.arange(RUNS) < alarms * RUNS
    names = {WINDOW: quiet, CLEAN: quiet, **dict.fromkeys(EVENTS, quiet), **more.pop("events", {})}
    sizes = {"runs": RUNS, "selection_runs": 4, "entropy": 0, "window_s": 160.0}
    score = DetectorScore(
        task="D1",
        detector="mine",
        alert_limit_m=LIMIT,
        families=families or (family("ramps", 10.0),),
        false_alarms=names,
        **sizes,
    )
    shape = 5, 3, 16
    seen = np.broadcast_to(np.arange(5)[:, None, None] < 5 * found, shape)
    probe = AgeProbe(
        age_s=np.array([30.0, 180.0, 600.0]),
        rate_mps=np.ones(5),
        counts=np.ones(shape[1:], dtype=bool),
        found=seen,
        crossed=np.ones(shape, dtype=bool),
        missed=~seen,
        displacement=np.ones(shape),
        threshold=np.ones(3),
        sky=np.arange(16),
        alike=np.array(more.pop("alike", True)),
    )
    usual = {"title": "small", "budget": "quick", "requested_per_hour": 0.2, "cost_us": 1.0}
    return Audit(score=score, probe=probe, **usual, **{"floor_m": None, "reference": None, **more})


SPREAD = np.linspace(8.0, 12.0, RUNS)
FLOOR = {"half": {"value": 20.0}, "few": {"value": 30.0}}


@pytest.mark.parametrize(
    ("audit", "message"),
    [
        (audit_of(broken="breaks the contract: `needs`"), "breaks the contract: `needs`"),
        (audit_of(alike=False), "two calls on the same epochs differ"),
        (audit_of(alarms=1.0), "alarms in every run, with an attack and without one"),
        (audit_of(found=0.0), "never alarms, with an attack or without one"),
        (audit_of(alarms=0.4), "alarms since switch-on in 40 % of the runs without an attack"),
        (audit_of(alarms=0.1), "false alarms 2.4 (1.1 to 4.4) an hour, above the 0.2"),
        (
            audit_of(events={"front": np.arange(RUNS) < 50}),
            "takes benign events for attacks: alarms in 50 % of the runs with a front, in 0 % of "
            "those without",
        ),
        (
            audit_of(family("ramps", SPREAD), family("open-loop", SPREAD - 2.0)),
            "the search failed: what ramps exceed in half of the runs is 2.0 (within 0.05) m more",
        ),
        (
            audit_of(family("open-loop", SPREAD, SPREAD + 2.0)),
            "the search failed: what attacks that were found against other detectors exceed in "
            "half of the runs is 2.0 (within 0.05) m more",
        ),
        (audit_of(floor_m=FLOOR), "no attack gets beyond the 20.0 m that even a perfect detector"),
    ],
)
def test_every_warning_stands_where_it_is_earned(audit, message):
    assert any(text.startswith(message) for text in audit.warnings)
    lines = format_screen(audit)
    assert len(lines) <= LINES
    assert max(map(len, lines)) <= WIDTH
    assert message.split(":")[0] in " ".join(" ".join(lines).split())
    assert json.dumps(audit.as_dict(), allow_nan=False)


def test_a_bound_that_is_not_known_has_its_reason_in_a_few_words():
    timeline, domain = {"warmup_s": 30.0, "live_s": 10.0}, {"age_s": (30.0, 120.0)}
    aged = zero_alarm_bounds(TightlyCoupledSetup(timeline=timeline, domain=domain), Raim(), [])
    setup = TightlyCoupledSetup(timeline=timeline)
    refused = zero_alarm_bounds(setup, Raim(), draw_worlds(setup, 1))
    assert refused.why == f"{EXCLUDES}; {OPEN_LOOP_NOTE}"
    known = (
        (aged, "ages are drawn"),
        (refused, "it excludes satellites or fixes, and tests other ..."),
    )
    for bound, reason in ((each.as_json(), text) for each, text in known):
        ramps = family("ramps", 10.0)
        known = ramps._replace(protection=replace(ramps.protection, head={"zero_alarm": bound}))
        assert f"alarm exceeds   not known ({reason})" in " ".join(format_screen(audit_of(known)))


def test_runs_that_are_all_the_same_leave_an_interval():
    probe = audit_of(found=0.4).probe
    q = 1.0 - 0.025 ** (1.0 / 16.0)  # exact, for none of 16 skies
    assert probe.estimate_missed() == pytest.approx((0.6, 0.6 - 0.6 * q, 0.6 + 0.4 * q))
    assert probe.compare_ages(1, 0) == pytest.approx((0.0, -q, q))
    falls = replace_found(probe, np.array([0.8, 1.0])[np.arange(16) % 2], np.zeros(16))
    least, most = falls.estimate_share(0)[1:]
    assert falls.compare_ages(1, 0) == pytest.approx((-0.9, -most, q - least))
    (text,) = falls.warn()
    words = "0 % after 3 min: a difference of 90 (64 to 95) percentage points in the same runs"
    assert words in text
    assert audit_of(found=0.0).probe.estimate_share(0) == pytest.approx((0.0, 0.0, q))


def replace_found(probe, *shares):
    """A probe of as many ages, at which each of its runs finds a share of the five ramps."""
    found = np.arange(5)[:, None, None] < np.round(5.0 * np.array(shares)) - 1e-9
    few = slice(len(shares))
    return probe._replace(
        found=found,
        counts=probe.counts[few],
        threshold=probe.threshold[few],
        age_s=probe.age_s[few],
    )


@pytest.mark.parametrize("rate", [0.02, 0.05, 0.1])
def test_where_no_run_finds_any_the_difference_is_covered_as_the_bounds_of_both_ages_are(rate):
    rng, probe, truth = np.random.default_rng(0), audit_of().probe, rate - 0.9
    covered, bootstrapped = [], []
    for _ in range(400):
        seen, blind = rng.choice([0.8, 1.0], 16), (rng.random(16) < rate).astype(float)
        if not blind.any():
            found = replace_found(probe, seen, blind).compare_ages(1, 0)
            covered.append(found.low <= truth <= found.high)
            alone = bootstrap_mean(blind - seen, draw_resamples(np.arange(16)))
            assert found.low <= alone.low + 1e-9 < alone.high - 1e-9 <= found.high
            bootstrapped.append(alone.low <= truth <= alone.high)
    assert len(covered) > 50
    assert np.mean(covered) > 0.95
    assert np.mean(bootstrapped) < 0.92


def test_what_is_as_it_should_be_is_not_warned_of():
    audit = audit_of(
        family("ramps", SPREAD),
        family("open-loop", SPREAD + 0.1, SPREAD),
        alarms=0.01,
        floor_m=None,
    )
    assert audit.warnings == []
    assert audit.find_worst(0.5).family == "open-loop"
    value = audit.score.estimate_quantile(0.5).value
    assert str(audit) == (
        f"mine: {value:.1f} m in half of the runs (worst: open-loop), false alarms 0.23/h "
        "(requested 0.2)"
    )
    silent = replace(
        audit, score=replace(audit.score, families=(family("ramps", 1.0, silent=False),))
    )
    assert silent.answer == "mine: no score, as no run is silent without an attack"


@pytest.mark.parametrize(("short", "tail"), [(1, ", a difference within the intervals"), (20, "")])
def test_the_verdict_names_the_worst_attacks_and_when_the_limit_is_passed(short, tail):
    far = family("open-loop", np.where(np.arange(RUNS) < short, 1.0, 20.0))
    record = audit_of(family("ramps", 10.0), far, alarms=0.03).as_dict()
    replay = {"detector": "mine", "age_s": 80.5, "alarm_s": None}
    replay |= {"time": [0.5, 1.0, 1.5], "error": [0.0, LIMIT, 3.0], "attack": None}
    world = {"timeline": {"attack_s": 150.0}, "domain": {"age_s": [60.0, 3600.0]}}
    search = {"generations": 6, "population": 12, "runs": 96}
    verdict = {head: text for head, text in write_score_verdict(record, world, replay, search)}
    why = verdict["By what attack"]
    assert "has the largest displacement exceeded in 50 % and in 5 % of the runs; the family" in why
    assert f"passes {LIMIT:g} m with no alarm in time (P(HMI)) most often, in 100.0 (" in why
    assert f"against {100 - short:.1f} (" in why
    assert why.endswith(f" % of those of open-loop{tail}.")
    when = verdict["After how long"]
    assert when.startswith("of fixed test ramps 60 % raise an alarm, begun 30 s to 10 min after")
    assert "10 min after switch-on; the intervals at these times overlap. Of the ramps that" in when
    assert "60 % raise an alarm, begun 30 s to 10 min after switch-on" in when
    assert "begins at a random time, 1 min to 60 min after switch-on. In the run" in when
    assert "the error passed 2 m 1.5 s after the attack began, and there was no alarm in" in when
    assert "had been on for 80.5 s. An alarm up to 10 s after an error is in time" in when
    record["ages"]["found"][1] = {"value": 0.1, "low": 0.0, "high": 0.2}
    when = dict(write_score_verdict(record, world, replay))["After how long"]
    assert "60 % raise an alarm 30 s after it, 10 % raise an alarm 3 min after it" in when
    assert "in 3 of 100 windows of 160 s" in verdict["False alarms"]
    assert "searched for on 96 runs, by 6 generations of 12 candidates. Of" in verdict["How sure"]
    other = dict(write_score_verdict(record, world, {**replay, "detector": "another"}))
    assert "replayed below" not in "".join(other.values())


def test_a_whole_audit_of_a_detector_of_ones_own(tmp_path, monkeypatch):
    spec = {"name": "tests.outside.detectors:AverageRate", "threshold_scale": 30.0}
    sizes = {
        "runs": 6,
        "selection_runs": 4,
        "families": ["ramps", "dashes"],
        "entropy": 0,
        "threads": 1,
    }
    found = spoofgym.audit(spec, small_task(), "quick", folder=tmp_path, **sizes)
    monkeypatch.setattr("spoofgym.testing.detector.check_detector", lambda judge: None)
    again = spoofgym.audit(spec, small_task(), "quick", folder=tmp_path, **sizes)
    assert {**again.as_dict(), "cost_us": 0.0} == {**found.as_dict(), "cost_us": 0.0}
    assert found.requested_per_hour is None
    assert "(thresholds as published)" in found.answer
    names = {path.stem for path in (tmp_path / "small" / "attacks").iterdir()}
    assert {name.rpartition("-")[2] for name in names} == {"ramps", "dashes", "worst"}
    assert found.zero_alarm is None
    assert found.cost_us > 0.0
    plan = Auditor(small_task(), "quick", **sizes)
    replay = replay_worst_attack(plan, specify_detector(spec), found.score.families)
    attack, line = replay["attack"], plan.task.world_kwargs["timeline"]
    assert (replay["age_s"], replay["attack_s"]) == (line["warmup_s"], line["attack_s"])
    assert attack["times_s"] == [0.5, 5.0, 10.0, 15.0, 20.0]
    moved = np.trapezoid(attack["rates_mps"], attack["times_s"])
    assert attack["displacement_m"] == pytest.approx(moved, rel=0.1)
    assert max(attack["rates_mps"]) <= attack["rate_limit_mps"]
    assert not attack["sees_statistic"]


@pytest.mark.parametrize(
    "passes",
    [
        [{"shard": (1, 2)}, {"shard": (2, 2)}],
        pytest.param([{"jobs": 2}], marks=pytest.mark.nightly),
        pytest.param([{"jobs": 2, "backend": "dask"}], marks=pytest.mark.nightly),
        pytest.param([{"jobs": 2, "backend": "ray"}], marks=pytest.mark.nightly),
    ],
)
def test_figures_are_those_of_one_process_in_shards_and_in_several(passes, tmp_path):
    if "backend" in passes[0]:
        pytest.importorskip(passes[0]["backend"])
    settings = {"runs": 4, "selection_runs": 4, "families": ["dashes"], "entropy": 0, "threads": 1}
    plain, auditor = (
        Auditor(small_task(), "quick", folder=folder, **settings) for folder in (None, tmp_path)
    )
    spec = {"name": "snapshot-chi2", "thresholds": "nominal"}
    expected = plain.prepare(spec)
    expected = expected.conclude(plain.run(expected))
    for each in passes:  # the last one reads what the others have finished
        cells = auditor.prepare(spec)
        results = run_experiment(cells, Store(auditor.folder), threads=1, **each)
    assert not results.missing
    found = cells.conclude(results)
    assert {**found.as_dict(), "cost_us": 0.0} == {**expected.as_dict(), "cost_us": 0.0}


@cache
def auditor_of(task):
    """One of the worlds of a task, which take seconds to build."""
    return Auditor(task, "quick", entropy=0, threads=1)


@pytest.mark.parametrize(
    ("task", "detector", "names"),
    [
        ("D1", "snapshot-chi2", ["snapshot-chi2-ppo"]),
        ("D1", "aime", ["hidden-pool-ppo"]),
        ("D1", "never", []),
        ("D2", "snapshot-chi2", []),  # whose decisions take longer
    ],
)
def test_shipped_spoofers_that_were_made_for_a_detector_are_a_family(task, detector, names):
    auditor = auditor_of(task)
    assert auditor.families[-1] == module.TRAINED
    found = auditor.worlds.list_attacks(module.TRAINED, specify_detector(detector))
    assert [each.player.spec["file"] for each in found] == names


def test_where_none_was_made_for_a_detector_the_family_is_left_out_or_refused():
    auditor = Auditor(small_task(), "quick", entropy=0, threads=1, families=["shipped"])
    with pytest.raises(ValueError, match="no shipped spoofer was made for never and fits small"):
        auditor.prepare("never")
    cells = AuditCells(auditor, auditor.worlds.build_detectors(["never"]), scores_only=True)
    with pytest.raises(ValueError, match="no shipped spoofer"):
        list(cells.cells())


class Flat(AverageRate):
    def judge(self, epoch):
        return Verdict(*(part[:, 0] for part in super().judge(epoch)[:3]))


def test_what_no_run_can_do_without_is_checked_before_anything_plays():
    said = []
    with pytest.raises(ValueError, match=r"Flat: on .*`statistic` must have shape \(5, 1\)"):
        module.check_contract(Flat, said.append)
    given, broken = module.check_contract(Whim, said.append)
    assert given is Whim
    assert module.check_contract("never", said.append) == ("never", None)
    assert broken.startswith("breaks the contract of detectors, and is audited as it is: When")
    assert said == [f"Whim {broken}"]


def test_a_class_with_a_rate_is_checked_without_a_world():
    spec = {"name": "tests.outside.detectors:AverageRate", "false_alarms_per_hour": 1.0}
    given, broken = module.check_contract(spec, print)
    assert given["false_alarms_per_hour"] == 1.0
    assert broken is None


def test_a_quick_audit_scales_everything():
    quick, standard, full = BUDGETS.values()
    for small, large in ((quick, standard), (standard, full)):
        assert small.runs < large.runs
        assert small.selection_runs < large.selection_runs
        assert small.search.runs < large.search.runs
        assert small.twins < large.twins


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (AverageRate, None),
        (GrowingThreshold, "threshold grows"),
        (BlindAfterFiveMinutes, "goes blind between 3 min and 10 min"),
    ],
)
def test_flaws_of_detectors_from_outside_stand_in_words_in_the_first_task(kind, words):
    name = f"tests.outside.detectors:{kind.__name__}"
    found = spoofgym.audit(name, "D1", "quick", families=["ramps", "open-loop"])
    aged = [text for text in found.warnings if "after switch-on" in text]
    assert len(aged) == (words is not None)
    assert words is None or words in aged[0]


def test_a_class_is_audited_as_its_name_is():
    sizes = {"runs": 4, "selection_runs": 4, "families": ["dashes"], "entropy": 1}
    named, given = (
        spoofgym.audit(each, small_task(), "quick", **sizes).as_dict() for each in ("never", Never)
    )
    assert named["p_hmi"] == given["p_hmi"]
    assert named["exceeded_m"] == given["exceeded_m"]
    assert named["detector"] == given["detector"]


@pytest.mark.parametrize("side", ["detector", "spoofer"])
def test_a_folder_that_takes_no_file_is_refused_before_anything_plays(side, tmp_path, monkeypatch):
    monkeypatch.setattr(Auditor, "prepare", None)
    monkeypatch.setattr("spoofgym.cli.audit.calibrate_suite", None)
    (tmp_path / "file").write_text("")
    words = ["--seed", "0", "--budget", "quick", "--out", str(tmp_path / "file")]
    given = ["never"] if side == "detector" else ["--spoofer", "ramp"]
    assert "file: File exists" in refused("audit", *given, *words)
