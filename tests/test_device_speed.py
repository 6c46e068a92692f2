"""The measure of a device's speed, on the processor, with settings that take seconds."""

import json
import sys

import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "onnxscript", "tyro"):
    pytest.importorskip(name)

from benchmarks import device

SHORT = {"warmup_s": 6.0, "live_s": 3.0, "attack_s": 5.0, "time_to_alert_s": 1.0}


def test_all_speeds_are_of_the_device_that_is_named(monkeypatch, capsys):
    def call(*given):
        monkeypatch.setattr(sys, "argv", ["benchmarks.device", "--device", "cpu", *given])
        device.main()
        return capsys.readouterr().out

    small = "--steps", "2", "--runs", "2", "--updates", "1", "--receivers", "2", "4"
    small += "--world", json.dumps({"timeline": SHORT})
    found = json.loads(call(*small, "--json"))
    assert found["device"] == "processor"
    assert [*found["receivers"]] == ["2", "4"]
    rates = [rate for each in found["receivers"].values() for rate in each.values()]
    assert min(*rates, found["clean_epochs_per_s"]) > 0.0
    # two seconds for 2 x 4 steps are 4 a second
    monkeypatch.setattr(device, "take_time", lambda work, _: 2.0)
    found = json.loads(call(*small, "--json"))
    assert found["receivers"]["4"]["env_steps_per_s"] == 4.0
    assert found["clean_epochs_per_s"] == 2.0 * (6.0 + 5.0 + 1.0) / 0.5 / 2.0
    assert "clean epochs/s" in call(*small)
    with pytest.raises(SystemExit):
        call("--steps", "0")
