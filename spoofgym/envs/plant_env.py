"""Environments over any plant, single and vector; a subclass names its plant."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from gymnasium.vector import AutoresetMode

from ..detectors import Detector
from .game_env import GameEnv
from .game_vector_env import GameVectorEnv, autoreset_mode_of, check_vector_settings
from .infos import InfoSpec
from .plant import Plant
from .plant_game import PlantGame
from .presets import WatchSpec
from .rendering import PlantRecorder, Recorder, Seen
from .setup import Timeline
from .terms import ActionSpec, EndSpec, RewardSpec

RECEIVERS = "receivers"
"""Argument of a plant that an environment sets by itself."""


def plant_settings(kind: type[Plant]) -> dict[str, inspect.Parameter]:
    """Settings that a plant takes."""
    found = inspect.signature(kind).parameters
    return {name: argument for name, argument in found.items() if name != RECEIVERS}


def make_plant(kind: type[Plant], receivers: int, settings: Mapping[str, Any]) -> Plant:
    """Plant with settings; an unknown one is refused with the valid ones.

    `settings`: by name; None for the plant's own default.
    """
    known = plant_settings(kind)
    for name in settings:
        if name not in known:
            valid = signature_over(kind, inspect.signature(PlantEnv.__init__)).parameters
            raise ValueError(
                f"the environment {kind.kind!r} has no setting {name!r}; valid: {', '.join(valid)}"
            )
    make: Callable[..., Plant] = kind
    return make(receivers, **{key: value for key, value in settings.items() if value is not None})


def signature_over(kind: type[Plant], own: inspect.Signature) -> inspect.Signature:
    """Arguments of an environment, with those of its plant in the place of ``**settings``."""
    kept = [p for p in own.parameters.values() if p.kind is not p.VAR_KEYWORD and p.name != "self"]
    names = {argument.name for argument in kept}
    more = [
        argument.replace(kind=argument.KEYWORD_ONLY)
        for name, argument in plant_settings(kind).items()
        if name not in names
    ]
    return own.replace(parameters=[*kept, *more])


class PlantEnv(GameEnv[PlantGame]):
    """A spoofer against one receiver of a plant.

    Parameters
    ----------
    detector : str, mapping or Detector, optional
        A name in `DETECTORS`, a dict with a name and settings, or an object, which is copied; the
        plant's own by default.
    timeline : mapping or Timeline, optional
        Lengths of warm-up, attack window and time to alert; the plant's own by default.
    knowledge : {"tracking", "blind", "oracle"}
        What the spoofer observes.
    action : str, mapping, path, ActionTerm or sequence of them, optional
        Own list of terms instead of the plant's elements, as `make_terms` takes them.
    reward : str, mapping, path, RewardTerm or sequence of them, optional
        Own list of terms.
    end : str, mapping, path, EndTerm or sequence of them, optional
        Own list of terms instead of `end_at_alarm`; not the stealth budget, which needs the filter
        of the tightly coupled receiver.
    watch : sequence of str, mapping or Detector
        Detectors that judge the same epochs and change nothing; ``info["watch_NAME_alarm"]`` and
        more tell of them.
    alarm_penalty_m : float
        Price of an alarm, where `reward` does not say it.
    end_at_alarm : bool
        Whether an alarm ends the episode, where `end` does not say it.
    target_heading_deg : float
        Direction in which displacement counts, clockwise from north.
    render_mode : {"human", "rgb_array"}, optional
        Whether a window shows the episode, or `render` returns pictures of it.
    **settings
        Those of the plant.

    Attributes
    ----------
    plant_type : type
        The plant; set by a subclass.
    given_detector : object
        Detector that has been set, as it was given; None for the plant's own.
    """

    plant_type: ClassVar[type[Plant]]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Let the signature show the plant's settings."""
        super().__init_subclass__(**kwargs)
        own = inspect.signature(PlantEnv.__init__)
        cls.__signature__ = signature_over(cls.plant_type, own)  # type: ignore[attr-defined]

    def __init__(
        self,
        *,
        detector: str | Mapping[str, Any] | Detector | None = None,
        timeline: Mapping[str, float] | Timeline | None = None,
        knowledge: str = "tracking",
        action: ActionSpec | None = None,
        reward: RewardSpec | None = None,
        end: EndSpec | None = None,
        watch: WatchSpec = (),
        alarm_penalty_m: float = 10.0,
        end_at_alarm: bool = True,
        target_heading_deg: float = 90.0,
        render_mode: str | None = None,
        **settings: Any,
    ) -> None:
        given = {"detector": detector, "timeline": timeline, **settings}
        game = PlantGame(
            make_plant(self.plant_type, 1, given),
            knowledge=knowledge,
            action=action,
            reward=reward,
            end=end,
            watch=watch,
            alarm_penalty_m=alarm_penalty_m,
            end_at_alarm=end_at_alarm,
            target_heading_deg=target_heading_deg,
        )
        self.given_detector: Any = detector
        super().__init__(game, render_mode)

    def _recorder(self) -> Recorder | None:
        """What looks at the plant, if it can be seen."""
        return PlantRecorder(self.game) if isinstance(self.game.plant, Seen) else None


class PlantVectorEnv(GameVectorEnv[PlantGame]):
    """Vector environment of a plant; receiver i is the single one seeded with ``seed + i``.

    Parameters
    ----------
    num_envs : int
        Receivers, at least 1.
    autoreset_mode : {"next_step", "same_step", "disabled"} or AutoresetMode
        When a finished receiver begins its next episode; with ``disabled``, when ``reset`` is
        called with ``options={"reset_mask": ...}``.
    infos : {"all", "none"} or sequence of str
        Which information is handed out, by its keys; `final_obs` and `final_info` always are.
    max_episode_steps : int, optional
        Of `gymnasium.make_vec`, from a spec: more than an episode has, and without effect.
    detector, timeline, knowledge, action, reward, end, watch, alarm_penalty_m, end_at_alarm
        As in `PlantEnv`.
    target_heading_deg, render_mode, **settings
        As in `PlantEnv`.

    Attributes
    ----------
    plant_type : type
        The plant; set by a subclass.
    given_detector : object
        Detector that has been set, as it was given; None for the plant's own.
    """

    plant_type: ClassVar[type[Plant]]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Let the signature show the plant's settings."""
        super().__init_subclass__(**kwargs)
        own = inspect.signature(PlantVectorEnv.__init__)
        cls.__signature__ = signature_over(cls.plant_type, own)  # type: ignore[attr-defined]

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        infos: InfoSpec = "all",
        max_episode_steps: int | None = None,
        detector: str | Mapping[str, Any] | Detector | None = None,
        timeline: Mapping[str, float] | Timeline | None = None,
        knowledge: str = "tracking",
        action: ActionSpec | None = None,
        reward: RewardSpec | None = None,
        end: EndSpec | None = None,
        watch: WatchSpec = (),
        alarm_penalty_m: float = 10.0,
        end_at_alarm: bool = True,
        target_heading_deg: float = 90.0,
        render_mode: None = None,
        **settings: Any,
    ) -> None:
        mode = autoreset_mode_of(autoreset_mode)
        check_vector_settings(num_envs, render_mode)
        given = {"detector": detector, "timeline": timeline, **settings}
        game = PlantGame(
            make_plant(self.plant_type, num_envs, given),
            knowledge=knowledge,
            action=action,
            reward=reward,
            end=end,
            watch=watch,
            alarm_penalty_m=alarm_penalty_m,
            end_at_alarm=end_at_alarm,
            target_heading_deg=target_heading_deg,
        )
        self.given_detector: Any = detector
        super().__init__(game, mode, infos, max_episode_steps)
