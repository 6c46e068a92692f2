"""Training scripts: one complete file for every kind of training run."""

from spoofgym.core.extras import name_extra

try:
    import stable_baselines3  # noqa: F401
    import tyro  # noqa: F401
except ImportError as error:
    raise name_extra("train", error) from error
