"""The game: engine, observations, actions, rewards, and its views for Gymnasium."""

from .attach import attach
from .engine import Batch, Engine
from .game import Game
from .loose_env import LooselyCoupledEnv, LooselyCoupledVectorEnv
from .observations import Observer, terms_of
from .played import Turn
from .presets import make_game, make_setup
from .robot_env import WheeledRobotEnv, WheeledRobotVectorEnv
from .setup import Setup, Timeline
from .snapshot_env import SnapshotEnv, SnapshotVectorEnv
from .spoof_env import SpoofEnv
from .vector_env import SpoofVectorEnv

__all__ = [
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
    "terms_of",
]
