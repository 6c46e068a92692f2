"""The page on the duel: its code runs, and what it says of settings is so."""

import re
import types
from pathlib import Path

import numpy as np
import pytest

from spoofgym import duel_v0
from spoofgym.duel.agent import EXCLUSION_S
from spoofgym.duel.payoff import RunningThreshold, Weighted

from ..spoofers.policies import network

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "duel.md").read_text()
CODE = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.fixture(scope="module")
def page():
    module = types.ModuleType("page")
    for number, block in enumerate(CODE):
        exec(compile(block, f"duel.md block {number}", "exec"), module.__dict__)
    return module


def test_the_blocks_run_in_their_order(page):
    assert 0.0 < page.calibration.threshold < 1.0
    assert page.duel.unwrapped.rules.duel.threshold.values == [page.calibration.threshold]
    assert page.guard.opponent in ("none", "step", "accelerating-ramp", "ramp, rate_mps=0.2")


def test_a_policy_is_saved_as_the_page_says(page, tmp_path, monkeypatch):
    calls = []

    def few(policy, runs, timeline=None):
        calls.append(runs)
        return calibrate(policy, runs=19, timeline=page.short)

    calibrate = duel_v0.calibrate
    monkeypatch.setattr(duel_v0, "calibrate", few)
    file = tmp_path / "guard.onnx"
    sizes = page.guard.observation_space.shape[0], page.guard.action_space.shape[0]
    file.write_bytes(network(*sizes).SerializeToString())
    page.save(file, page.guard)
    assert calls == [200]
    assert 0.0 < duel_v0.OnnxDetector(file).card.threshold <= 1.0


def test_numbers_of_the_page_are_the_defaults():
    assert f"`exclusion_s={EXCLUSION_S}`" in PAGE
    prices = Weighted()
    assert f'"false_alarm": {prices.false_alarm},' in PAGE
    assert f'"delay_per_s": {prices.delay_per_s}, "error_per_m": {prices.error_per_m}' in PAGE
    rule = RunningThreshold(0.05, 1)
    assert f"{rule.GAIN:g} (a - alpha)" in PAGE
    assert f"alpha + {(1.0 + rule.GAIN - rule.FIRST) / rule.GAIN:g}/n" in PAGE


def test_names_of_the_policy_in_the_page_are_average_innovations():
    view = duel_v0.DetectorView(timeline={"warmup_s": 5.0, "live_s": 1.0, "attack_s": 5.0})
    assert all(name.startswith("range_average") for name in view.observation_names[24:36])
    assert np.isfinite(view.observation_space.high).all()
