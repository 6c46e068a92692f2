"""Progress of a training, as a bar."""

from __future__ import annotations

from rich.console import Console
from rich.progress import Progress
from stable_baselines3.common.callbacks import BaseCallback


class Bar(BaseCallback):
    """Shows how far a training is.

    - `console`: where it is shown;
    - `name`: of the training;
    - `steps`: of all receivers together, to its end.
    """

    def __init__(self, console: Console, name: str, steps: int) -> None:
        super().__init__()
        self.progress = Progress(*Progress.get_default_columns(), console=console)
        self.task = self.progress.add_task(name, total=steps)

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        self.progress.update(self.task, completed=self.num_timesteps)
