"""How long a machine of hypothesis runs, and worlds in which a test may do harm."""

from __future__ import annotations

import os
import time
from dataclasses import replace

import hypothesis
import numpy as np
from hypothesis.stateful import RuleBasedStateMachine, run_state_machine_as_test

MINUTES = "SPOOFGYM_SOAK_MINUTES"
PARTS = 2
"""Nightly tests that share these minutes."""


def run_slice(machine: type[RuleBasedStateMachine], examples: int, steps: int) -> None:
    """The same few examples everywhere."""
    given = hypothesis.settings(
        max_examples=examples,
        stateful_step_count=steps,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=[*hypothesis.HealthCheck],
    )
    run_state_machine_as_test(machine, settings=given)


def run_soak(machine: type[RuleBasedStateMachine]) -> None:
    """Other examples at every call, until the share of the minutes is over."""
    end = time.monotonic() + 60.0 * float(os.environ.get(MINUTES, "10")) / PARTS
    given = hypothesis.settings(
        max_examples=20,
        stateful_step_count=80,
        deadline=None,
        derandomize=False,
        database=None,
        print_blob=True,
        suppress_health_check=[*hypothesis.HealthCheck],
    )
    while time.monotonic() < end:
        run_state_machine_as_test(machine, settings=given)


def loosen_world(world):
    """A world with arrays of its own, which may be written to; those of others stay."""
    names = ("run", "satellites", "visible")
    return replace(world, **{each: getattr(world, each).copy() for each in names})


def hide_satellites(world, epoch, count, channels):
    """Let satellites set for some epochs."""
    world.satellites[epoch + 1 : epoch + 1 + count, channels, 6] = 0.0
    world.visible[epoch + 1 : epoch + 1 + count, channels] = False


def saturate_sensors(world, epoch, count, level):
    """Hold what the inertial sensors feel at a limit for some epochs [m/s^2], ten times a radian
    a second."""
    end = world.epoch_end
    samples = slice(end[epoch], end[min(epoch + count, len(end) - 1)])
    world.run[:3, samples], world.run[3:6, samples] = level, np.sign(level) * 10.0


def shift_field(simulator, name, shift):
    """Add to an error of all sensors: a jump of the clock, or an offset of ranges [m]."""
    rows, fields = np.arange(simulator.receivers), simulator.sensors.fields
    fields.put(name, rows, fields.get(name, rows) + shift)
