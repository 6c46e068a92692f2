"""The measurement of speed measures what a step is made of, and nothing else."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import perf

EPOCH = [name for name in perf.KERNELS if name not in (perf.COVARIANCE_S, perf.FLOOR)]


@pytest.mark.nightly
def test_the_parts_of_a_step_one_after_the_other_are_an_epoch(monkeypatch):
    monkeypatch.setattr(perf, "COMMAND", 0.0)
    rig = perf.Rig(5, 1)
    simulator = rig.engine.simulator
    changed = rig.fields[0], rig.fields[2]
    before = [each.data.copy() for each in changed]
    for name in EPOCH:
        rig.run_part(name, 1)
    rig.run_part(perf.COVARIANCE_S, 1)
    simulator.advance()
    simulator.update(None)
    whole = simulator.buffers.fields, simulator.sensors.fields
    for was, part, its in zip(before, changed, whole, strict=True):
        assert np.array_equal(part.data, its.data)
        assert not np.array_equal(part.data, was)


@pytest.mark.nightly
def test_the_floor_stays_with_one_group_per_thread():
    rig = perf.Rig(40, 2)
    before = rig.fields[0].data.copy()
    rig.run_part(perf.FLOOR, 3)
    rig.close()
    assert np.isfinite(rig.fields[0].data).all()
    moved = (before != rig.fields[0].data).reshape(5, -1).any(axis=1)
    assert moved.tolist() == [True, False, True, False, False]


@pytest.fixture
def measured(monkeypatch):
    monkeypatch.setattr(perf, "PIECE_S", 1e-4)
    return lambda *options: CliRunner().invoke(perf.app, ["--quick", *options])


@pytest.mark.nightly  # as all that compiles kernels of its own
def test_the_command_reports_every_part_of_every_batch(measured):
    sizes = ["--receivers", "1", "--receivers", "9", "--threads", "1", "--threads", "2"]
    found = json.loads(measured(*sizes, "--json").stdout)
    assert found["rounds"] == perf.QUICK_ROUNDS
    assert found["machine"]["processors"] >= 1
    batches = [(run["receivers"], run["threads"]) for run in found["runs"]]
    assert batches == [(1, 1), (9, 1), (9, 2)]  # a single receiver has no second group
    for run in found["runs"]:
        us = run["us"]
        assert list(us) == [*perf.PARTS, perf.ENGINE, perf.STEP, perf.EPISODE]
        assert min(us.values()) > 0.0
        ratio = us[perf.ENGINE] / us[perf.FLOOR]
        assert run["step_over_floor"] == pytest.approx(ratio, rel=0.01)
        together = sum(us[name] for name in (*EPOCH, perf.ATTACK, perf.JUDGE))
        assert run["parts_us"] == pytest.approx(together, rel=0.01)
        assert run["env_steps_per_s"] == pytest.approx(1e6 / us[perf.EPISODE], rel=0.01)
    refused = measured("--receivers", "8", "--threads", "2")
    assert refused.exit_code == 2
    said = "spoofgym: error: no batch of [8] receivers has a group of 8 for each of 2"
    assert said in refused.stderr


def test_every_array_of_a_receiver_counts_once():
    rig = perf.Rig(9, 1)
    found = perf.bytes_by_owner(rig.core)
    buffers = rig.core.engine.simulator.buffers
    shared = 8 * 8 * buffers.assumed.rows  # by all
    assert found["filter"] == (16 * 8 * buffers.fields.rows + shared) / 9  # two groups of eight
    assert found["epoch"] == 8 * (8 + 2 * 24) + 12 + 1
    score = found.pop("score of the episode")
    assert found.pop(perf.TOTAL) == pytest.approx(sum(found.values()))
    assert score > 0.0
    assert perf.bytes_by_owner(perf.Rig(64, 1).core)[perf.TOTAL] < 4000.0
