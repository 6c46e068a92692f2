"""The contract of a spoofer: an observation in, an action out."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..policies.contract import Policy
from .aim import Aim, check_heading
from .context import SpooferContext as SpooferContext

FloatArray = NDArray[np.float64]
KNOWLEDGE = (
    "blind",
    "tracking",
    "oracle",
    "blind+reported",
    "tracking+reported",
    "oracle+reported",
)


def sees_statistics(knowledge: str) -> bool:
    """Whether who observes this is an oracle: it has the victim's statistics, as nobody can."""
    return knowledge.startswith("oracle")


class Spoofer(Policy[SpooferContext]):
    """A spoofer with memory of B receivers.

    A subclass declares its arrays in `bind` (``self.memory.declare(name, initial)``, with a leading
    axis of receivers) and keeps nothing else from one command to the next, as detectors do.

    Attributes
    ----------
    knowledge : str
        What it observes at run time, one of `KNOWLEDGE`: its own commands and time (blind); also
        the target's true motion and the satellites (tracking); also the victim's statistics
        (oracle); to each of them ``+reported`` adds the position that the victim broadcasts.
    tunable : str or None
        Setting that a search under an alarm budget varies; more of it displaces further.  None for
        the factor on all commands that every spoofer has, `Scaled`.
    label : str or None
        Short name in results; by default it is made of the registered name and the settings.
    designed_on : str
        What it was optimised on before the attack: detector, receiver, scenario; or nothing.
    action_terms : str, mapping, sequence or None
        How its actions command the attack, as ``action=`` of `SpoofEnv`; None as there by default.
    decision_interval_s : float or None
        Time between its decisions; None for every decision of the world.
    between : {"hold", "linear"}
        What it commands between decisions of its own, as in environments.
    transmits : bool
        Whether it counterfeits at all.  An attack that is commanded nothing may still be seen, by
        its tracking error or its delay; where nothing is transmitted, measurements are authentic.
    memory : Memory
        What it remembers of every receiver.
    """

    knowledge: str
    tunable: ClassVar[str | None] = None
    transmits: ClassVar[bool] = True
    action_terms: Any = "full-command"
    decision_interval_s: float | None = None
    between: str = "hold"
    label: str | None = None
    designed_on: str = "nothing"

    @abstractmethod
    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        """Command the attack for the coming epoch.

        Parameters
        ----------
        observation : ndarray
            (B, o) of all receivers.

        Returns
        -------
        ndarray
            (B, a) in [-1, 1], C-contiguous.
        """

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        """Range of the tunable setting that is worth a search.

        Parameters
        ----------
        context : SpooferContext
            Limits of the attack.

        Returns
        -------
        low, high : float
            Both above 0.

        Raises
        ------
        ValueError
            When the spoofer has nothing to tune.
        """
        raise ValueError(f"{cls.__name__} has no setting to tune")


@dataclass(kw_only=True)
class ScriptedSpoofer(Spoofer):
    r"""Pushes along one line by a rule for the rate of every epoch, blind for what comes of it.

    The rate v and the displacement D that it has commanded follow the attack's own kinematics,

    .. math:: D^+ = D + \tfrac12 (v + v^+) \tau \quad\text{by acceleration}, \qquad
        D^+ = D + v^+ \tau \quad\text{by rate}

    and a subclass chooses the rate it wants next; limits are kept here.

    Parameters
    ----------
    heading_deg : float or "target"
        Direction of a false position, clockwise from north; or the target direction, where it is
        observed: ``target_heading_deg="random"`` draws it for every episode.  An attack on single
        channels has no heading: there all channels are commanded alike, which moves the receiver's
        clock alone if they are all that it sees.
    """

    heading_deg: float | str = 90.0

    knowledge = "blind"

    def __post_init__(self) -> None:
        check_heading(self.heading_deg)

    def bind(self, context: SpooferContext) -> None:
        """Prepare for a batch of receivers.

        Parameters
        ----------
        context : SpooferContext
            Sizes, limits and names.
        """
        super().bind(context)
        self._aim = Aim(context, self.heading_deg)
        for name in ("step", "rate", "displacement"):
            self.memory.declare(name, np.zeros(context.receivers))

    @abstractmethod
    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        """Rate that is wanted at the end of the coming epoch.

        Parameters
        ----------
        step : ndarray
            (B,) commands given so far.
        rate, displacement : ndarray
            (B,) commanded so far [m/s], [m].

        Returns
        -------
        ndarray
            (B,) [m/s]; cut to what the attack's limits allow.
        """

    def wanted_rate(self, observation: NDArray[np.float32]) -> FloatArray:
        """(B,) `next_rate` of all receivers [m/s]; a spoofer that is not blind looks here."""
        memory = self.memory
        return self.next_rate(memory["step"], memory["rate"], memory["displacement"])

    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        """Command the attack for the coming epoch.

        Parameters
        ----------
        observation : ndarray
            (B, o); a blind one looks at the target direction alone, where that is the heading.

        Returns
        -------
        ndarray
            (B, a) in [-1, 1].
        """
        context, memory = self.context, self.memory
        rate = memory["rate"]
        wanted = self.wanted_rate(observation)
        _, limit = context.largest_rate
        after = np.clip(wanted, -limit, limit)
        if context.control == "rate":
            size, mean = after / limit, after
        else:
            most = context.acceleration_limit_mps2 * context.interval_s
            asked, size = after, np.clip((after - rate) / most, -1.0, 1.0)
            after = rate + size * most
            mean = 0.5 * (rate + after)
            if context.setpoint_mps is not None:
                size = asked / context.setpoint_mps
        memory["displacement"] = memory["displacement"] + mean * context.interval_s
        memory["rate"] = after
        memory["step"] = memory["step"] + 1.0
        return np.ascontiguousarray(size[:, None] * self._aim(observation))


def check_limit(spoofer: Spoofer, name: str, limit_name: str, limit: float) -> None:
    value: Any = getattr(spoofer, name)
    if abs(value) > limit:
        raise ValueError(
            f"`{name}` = {value:g} is more than the attack allows: `{limit_name}` = {limit:g}"
        )
