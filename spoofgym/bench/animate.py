"""One evaluation run as frames of a animation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .._registry import whole_number
from ..envs.core import SpoofCore
from ..envs.rendering import CoreRecorder, Screen
from ..envs.spoofer_binding import commands_of
from .decisions import Attacker
from .entries import Entry, build_spoofer
from .suite import Suite


def play_frames(
    suite: Suite, detector: Entry, spoofer: Entry, run: int = 0, *, every: int = 1
) -> Iterator[NDArray[np.uint8]]:
    """Play one of the evaluation runs, and draw it; an alarm does not end it. Yields (H, W, 3)
    uint8."""
    run, every = whole_number("`run`", run), whole_number("`every`", every, 1)
    setup = suite.setup(detector, [spoofer])
    action = commands_of(build_spoofer(spoofer.spec), setup).terms
    core = SpoofCore(1, setup, action=action, end_at_alarm=False, threads=1)
    screen = Screen("rgb_array", CoreRecorder(core))
    core.reset(suite.generators("evaluation", run + 1, run))
    attacker = Attacker(spoofer.spec, core.engine)
    # where the world has decisions, the environment makes epochs of them
    action_of = attacker.action if setup.repeat == 1 else attacker.decide
    screen.begin({name: array[0] for name, array in core.reset_info().items()})
    yield screen.frame()
    for step in range(1, core.episode_steps + 1):
        result, _ = core.step(action_of((step - 1) * setup.repeat))
        screen.add({name: array[0] for name, array in result.info.items()})
        if step % every == 0 or step == core.episode_steps:
            yield screen.frame()
    core.close()


def frame_count(suite: Suite, detector: Entry, every: int = 1) -> int:
    """How many frames `play_frames` yields."""
    setup = suite.setup(detector)
    return 1 + -(-(setup.steps // setup.repeat) // every)
