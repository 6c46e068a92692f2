"""The page on the duel: its code runs, and what it says of settings is so."""

from types import SimpleNamespace

import numpy as np
import pytest

from spoofgym import duel_v0
from spoofgym.detectors.learned import EXCLUSION_S
from spoofgym.duel.payoff import RunningThreshold, Weighted

from ..spoofers.policies import network, written
from .pages import play, text_of

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate_of_module")

SMALLER = [
    ("TURNS, STEPS, RUNS = 4, 20_000, 200", "TURNS, STEPS, RUNS = 2, 64, 19"),
    ("512", "64"),
    (r"learn\(150_000", "learn(320"),
    (r"VecEnv\(32", "VecEnv(2"),
    ("1024", "64"),
]


@pytest.fixture(scope="module")
def page(default_rate_of_module):
    with pytest.MonkeyPatch.context() as patch:
        page = play("duel.md", patch)
        yield SimpleNamespace(**{**vars(page), **vars(play("self_play.md", patch, SMALLER))})


def test_the_blocks_run_in_their_order(page):
    threshold = page.calibration.point(per_run=0.1).scale
    assert 0.0 < threshold < 1.0
    assert page.duel.unwrapped.duel.threshold.values == [threshold]
    assert page.guard.opponent in ("none", "step", "accelerating-ramp", "ramp, rate_mps=0.2")
    # what its policy looks at are average innovations
    assert all(name.startswith("range_average") for name in page.guard.observation_names[24:36])
    assert np.isfinite(page.guard.observation_space.high).all()


def test_a_policy_is_saved_as_the_page_says(page, tmp_path, monkeypatch):
    calls = []

    def few(policy, runs, **game):
        calls.append(runs)
        return calibrate(policy, runs=19, **page.fast)

    calibrate = duel_v0.calibrate_policy
    monkeypatch.setattr(duel_v0, "calibrate_policy", few)
    file = tmp_path / "guard.onnx"
    sizes = page.guard.observation_space.shape[0], page.guard.action_space.shape[0]
    file.write_bytes(written(network(*sizes)))
    page.save(file, page.guard)
    assert calls == [200]
    assert 0.0 < duel_v0.OnnxDetector(file).card.threshold <= 1.0


def test_self_play_freezes_what_it_keeps_and_pays_what_single_environments_pay(page):
    pytest.importorskip("stable_baselines3")
    first, second = page.spoofers[2:]
    seen = page.attack.reset(seed=5)[0][None]
    assert not np.array_equal(first.act(seen), second.act(seen))  # the learner has gone on
    expected = page.attacker.predict(seen, deterministic=True)[0]
    np.testing.assert_array_equal(second.act(seen), expected)
    assert len({detector.threshold for detector in page.detectors[2:]}) == 2
    paid = page.undetected_m(page.s, page.d)
    view = duel_v0.SpooferView(pool=[page.d], **page.game)
    for row in range(3):
        seen, _ = view.reset(seed=1_000_000 + row)
        total, over = 0.0, False
        while not over:
            seen, reward, over, _, _ = view.step(page.s.act(seen[None])[0])
            total += reward
        assert total == pytest.approx(paid[row], abs=1e-3)  # networks round by the batch


def test_numbers_of_the_page_are_the_defaults():
    prices, rule, text = Weighted(), RunningThreshold(0.05, 1), text_of("duel.md")
    for said in (
        f"`exclusion_s={EXCLUSION_S}`",
        f'"false_alarm": {prices.false_alarm},',
        f'"delay_per_s": {prices.delay_per_s}, "error_per_m": {prices.error_per_m}',
        f"{rule.GAIN:g} (a - alpha)",
        f"alpha + {(1.0 + rule.GAIN - rule.FIRST) / rule.GAIN:g}/n",
    ):
        assert said in text
