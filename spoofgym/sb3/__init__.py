"""Stable-baselines3's vector environment, straight on the engine.

All receivers are one batch of a core; there is no list of environments underneath, and no
dictionary is filled for a receiver before its episode ends.

>>> from stable_baselines3 import PPO
>>> from spoofgym.sb3 import SpoofVecEnv
>>> envs = SpoofVecEnv(8, knowledge="blind", alarm_price=1.0)
>>> model = PPO("MlpPolicy", envs, gamma=1.0, n_steps=300, batch_size=2400, device="cpu")
>>> envs.close()

`SpoofVecEnv` takes any environment of the package by ``env_id``, a task by ``task``, and either
side of the duel by ``side``; `ScoreCallback` scores a policy while it learns.

Install it with the extra ``train``.
"""

from ..core.extras import name_extra

try:
    import stable_baselines3  # noqa: F401
except ImportError as error:
    raise name_extra("spoofgym.sb3", error) from error

from .callbacks import RecordEpochs, ScoreCallback
from .vec_env import DetectorWrapper, ResidualAction, SpoofVecEnv
from .wrappers import AlarmRecorder, PassiveDetector

__all__ = [
    "AlarmRecorder",
    "DetectorWrapper",
    "PassiveDetector",
    "RecordEpochs",
    "ResidualAction",
    "ScoreCallback",
    "SpoofVecEnv",
]
