"""One evaluation run as frames of a moving picture."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .._registry import whole_number
from ..envs.game import Game
from ..envs.presets import make_game
from ..envs.rendering import GameRecorder, Screen
from .entries import Entry
from .run import command
from .suite import Suite, make_bound_spoofer


def play_frames(
    suite: Suite, detector: Entry, spoofer: Entry, run: int = 0, *, every: int = 1
) -> Iterator[NDArray[np.uint8]]:
    """Play one of the evaluation runs, and draw it; an alarm does not end it.

    Yields (H, W, 3) uint8.
    """
    run, every = whole_number("`run`", run), whole_number("`every`", every, 1)
    setup = suite.setup(detector)
    player, observer = make_bound_spoofer(spoofer.spec, setup, 1)
    game: Game = make_game(1, setup, end_at_alarm=False, threads=1)
    screen = Screen("rgb_array", GameRecorder(game))
    game.reset(suite.generators("evaluation", run + 1, run))
    screen.begin({name: array[0] for name, array in game.begin_info().items()})
    yield screen.frame()
    for step in range(1, setup.steps + 1):
        turn = game.step(command(player, observer, game.engine, step - 1))
        screen.add({name: array[0] for name, array in turn.info.items()})
        if step % every == 0 or step == setup.steps:
            yield screen.frame()
    game.close()


def frame_count(suite: Suite, detector: Entry, every: int = 1) -> int:
    """How many frames `play_frames` yields."""
    return 1 + -(-suite.setup(detector).steps // every)
