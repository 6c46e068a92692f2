"""The game: engine, observations, actions, rewards, and its views for Gymnasium."""

from .attach import attach
from .engine import Batch, Engine
from .game import Game
from .observations import Observer, terms_of
from .played import Turn
from .presets import make_game, make_setup
from .setup import Setup, Timeline
from .spoof_env import SpoofEnv
from .vector_env import SpoofVectorEnv

__all__ = [
    "Batch",
    "Engine",
    "Game",
    "Observer",
    "Setup",
    "SpoofEnv",
    "SpoofVectorEnv",
    "Timeline",
    "Turn",
    "attach",
    "make_game",
    "make_setup",
    "terms_of",
]
