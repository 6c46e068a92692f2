"""The page on the duel: its code runs, and what it says of settings is so."""

import types

import numpy as np
import pytest

from spoofgym import duel_v0
from spoofgym.detectors.learned import EXCLUSION_S
from spoofgym.duel.payoff import RunningThreshold, Weighted

from ..spoofers.policies import network, written
from .pages import blocks_of, run, text_of

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate_of_module")

NAME = "duel.md"
PAGE = text_of(NAME)
SMALLER = [("TURNS, STEPS, RUNS = 4, 20_000, 200", "TURNS, STEPS, RUNS = 2, 64, 19"), ("512", "64")]


@pytest.fixture(scope="module")
def page(default_rate_of_module):
    module = types.ModuleType("page")
    for number, (needs, code) in enumerate(blocks_of(NAME)):
        if needs is None:
            run(code, f"{NAME} block {number}", module.__dict__)
    return module


@pytest.fixture(scope="module")
def self_play(page):
    """Names of the page after its blocks of self-play, made smaller."""
    scope = dict(page.__dict__)
    for needs, code in blocks_of(NAME):
        if needs is not None:
            pytest.importorskip(needs)
            for old, new in SMALLER:
                code = code.replace(old, new)
            run(code, f"{NAME}, self-play", scope)
    return scope


def test_the_blocks_run_in_their_order(page):
    threshold = page.calibration.point(per_run=0.1).scale
    assert 0.0 < threshold < 1.0
    assert page.duel.unwrapped.duel.threshold.values == [threshold]
    assert page.guard.opponent in ("none", "step", "accelerating-ramp", "ramp, rate_mps=0.2")


def test_a_policy_is_saved_as_the_page_says(page, tmp_path, monkeypatch):
    calls = []

    def few(policy, runs, timeline=None):
        calls.append(runs)
        return calibrate(policy, runs=19, timeline=page.short)

    calibrate = duel_v0.calibrate_policy
    monkeypatch.setattr(duel_v0, "calibrate_policy", few)
    file = tmp_path / "guard.onnx"
    sizes = page.guard.observation_space.shape[0], page.guard.action_space.shape[0]
    file.write_bytes(written(network(*sizes)))
    page.save(file, page.guard)
    assert calls == [200]
    assert 0.0 < duel_v0.OnnxDetector(file).card.threshold <= 1.0


def test_self_play_freezes_what_it_keeps(self_play):
    first, second = self_play["spoofers"][2:]
    seen = self_play["attack"].reset(seed=5)[0][None]
    assert not np.array_equal(first.act(seen), second.act(seen))  # the learner has gone on
    np.testing.assert_array_equal(
        second.act(seen), self_play["attacker"].predict(seen, deterministic=True)[0]
    )
    thresholds = [detector.threshold for detector in self_play["detectors"][2:]]
    assert len(set(thresholds)) == 2


def test_self_play_pays_what_single_environments_pay(self_play):
    spoofer, detector = self_play["s"], self_play["d"]
    paid = self_play["undetected_m"](spoofer, detector)
    view = duel_v0.SpooferView(pool=[detector], **self_play["game"])
    for row in range(3):
        seen, _ = view.reset(seed=1_000_000 + row)
        total, over = 0.0, False
        while not over:
            seen, reward, over, _, _ = view.step(spoofer.act(seen[None])[0])
            total += reward
        assert total == pytest.approx(paid[row], abs=1e-3)  # networks round by the batch


def test_numbers_of_the_page_are_the_defaults():
    assert all(old in PAGE for old, _ in SMALLER)
    assert f"`exclusion_s={EXCLUSION_S}`" in PAGE
    prices, rule = Weighted(), RunningThreshold(0.05, 1)
    assert f'"false_alarm": {prices.false_alarm},' in PAGE
    assert f'"delay_per_s": {prices.delay_per_s}, "error_per_m": {prices.error_per_m}' in PAGE
    assert f"{rule.GAIN:g} (a - alpha)" in PAGE
    assert f"alpha + {(1.0 + rule.GAIN - rule.FIRST) / rule.GAIN:g}/n" in PAGE


def test_names_of_the_policy_in_the_page_are_average_innovations():
    view = duel_v0.DetectorView(timeline={"warmup_s": 5.0, "live_s": 1.0, "attack_s": 5.0})
    assert all(name.startswith("range_average") for name in view.observation_names[24:36])
    assert np.isfinite(view.observation_space.high).all()
