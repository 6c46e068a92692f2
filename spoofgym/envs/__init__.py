"""The game: engine, observations, actions, rewards, and its views for Gymnasium."""

from .attach import attach
from .engine import Batch, Engine
from .game import Game
from .loose_env import LooselyCoupledEnv, LooselyCoupledVectorEnv
from .observations import terms_of
from .observer import Observer
from .played import Turn
from .presets import make_game, make_setup
from .robot_env import WheeledRobotEnv, WheeledRobotVectorEnv
from .setup import Setup, Timeline
from .snapshot_env import SnapshotEnv, SnapshotVectorEnv
from .spoof_env import SpoofEnv
from .terms import TERMS, make_terms
from .vector_env import SpoofVectorEnv

__all__ = [
    "TERMS",
    "Batch",
    "Engine",
    "Game",
    "LooselyCoupledEnv",
    "LooselyCoupledVectorEnv",
    "Observer",
    "Setup",
    "SnapshotEnv",
    "SnapshotVectorEnv",
    "SpoofEnv",
    "SpoofVectorEnv",
    "Timeline",
    "Turn",
    "WheeledRobotEnv",
    "WheeledRobotVectorEnv",
    "attach",
    "make_game",
    "make_setup",
    "make_terms",
    "terms_of",
]
