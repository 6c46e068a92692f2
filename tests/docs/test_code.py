"""The code of pages runs, block after block, and prints what they say."""

import re
from pathlib import Path

import pytest

from spoofgym.attacks import THREATS
from spoofgym.envs.terms import TERMS
from spoofgym.policies import DetectorCard
from spoofgym.testing import check_attack, check_detector

from .pages import play, text_of

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate_of_module", "in_tmp_path")

SHORT = {"warmup_s": 10.0, "live_s": 5.0, "attack_s": 10.0, "time_to_alert_s": 1.0}


@pytest.fixture
def played(monkeypatch, capsys):
    def play_page(page, *needed, smaller=()):
        for module in needed:
            pytest.importorskip(module)
        for kind in TERMS:  # a page may add to the registry
            monkeypatch.setitem(TERMS, kind, dict(TERMS[kind]))
        return play(page, monkeypatch, smaller), capsys.readouterr().out.splitlines()

    return play_page


def test_the_page_of_wrappers_checks_and_scores_its_detector(played):
    short = f'detector="never", timeline={SHORT}'
    smaller = [
        ('detector="never"', short),
        (r"env, 200", "env, 32, false_alarms_per_hour=10.0"),
        ('"snapshot-chi2"', '{"name": "snapshot-chi2", "thresholds": "nominal"}'),
    ]
    _, lines = played("detector_wrapper.md", smaller=smaller)
    assert lines[0].startswith("threshold x ")
    assert len(lines) == 5
    assert lines[-1].startswith("1 clean and 1 attacked episodes: ")


@pytest.mark.parametrize(
    ("page", "needed"),
    [
        ("cheaper_episodes.md", ()),
        ("corrections.md", ()),
        ("game.md", ()),
        ("offsets.md", ()),
        ("own_observation_term.md", ()),
        ("terms.md", ()),
        ("train_your_own.md", ("stable_baselines3",)),
        ("wrappers.md", ("pyarrow",)),  # as `RecordEpochs`
    ],
)
def test_the_code_of_a_page_runs(page, needed, played):
    played(page, *needed)


def test_the_code_on_worlds_plays_in_one_with_numbers_of_its_own(played):
    smaller = [("runs=2000", "runs=113"), (r'evaluate\("ramp", ', 'evaluate("ramp", runs=40, ')]
    code, (printed,) = played("worlds.md", smaller=smaller)
    assert code.mine.receiver.noise_model == code.assumed
    assert code.mine.scenario.gnss_errors == code.errors
    assert printed.startswith("ramp(tuned) (blind, rate_mps ")


def test_the_code_on_own_data_and_on_learning_prints_what_the_pages_say(played):
    _, printed = played("own_data.md")
    assert f"It prints `{printed[0]}`" in text_of("own_data.md")
    _, printed = played("learning.md")
    assert printed[0] == "3600 epochs, 360 decisions"
    assert float(printed[1].split()[0]) >= 60.0
    assert printed[1].endswith("1.0")
    assert printed[2] == "[0. 0. 0. 0.]"
    assert printed[3] == "[85. 85. 85.]"


@pytest.mark.nightly  # all worlds of tasks, which are golden
def test_the_code_on_tasks_names_worlds_and_families(played):
    _, printed = played("tasks.md")
    assert printed[0].startswith("airborne signals, tactical sensors, 150 s in a terminal area")
    assert len(printed) == 6
    _, (families,) = played("detector_tasks.md")
    assert "meaconer" in families  # a family that a task for detectors holds out


def test_the_code_on_pictures_draws_them(played):
    short = [(r'"attack_s": 30\.0', '"attack_s": 6.0')]
    _, printed = played("rendering.md", "matplotlib", smaller=short)
    assert "(700, 1120, 3) uint8" in printed
    assert Path("ramp.gif").stat().st_size > 10_000


def test_every_threat_has_its_two_rows_and_the_code_plays_them(played):
    code, _ = played("threats.md")
    for name in THREATS:
        assert len(re.findall(rf"^\| `{name}`[^|]*\|", text_of("threats.md"), flags=re.M)) == 2
    for name in ("quiet", "partial-constellation"):
        alarmed, east, undetected = code.play(name, runs=2, timeline=SHORT)
        assert 0.0 <= alarmed <= 1.0
        assert undetected >= east - 1e-9 or alarmed > 0.0


def test_detectors_of_the_catalogue_and_the_contributors_guide_keep_the_contract(played):
    code, _ = played("catalogue.md", "onnxscript")
    assert sorted(path.name for path in Path().iterdir()) == ["guard.json", "guard.onnx"]
    card = DetectorCard.load("guard.json")
    assert card == code.card
    assert [each.name for each in card.state] == ["hidden"]
    page = played("CONTRIBUTING.md")[0]
    check_detector(page.CumulativeSum())
    check_attack(page.ClockPush())
