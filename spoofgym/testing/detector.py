"""What every detector has to keep, tried on epochs of all kinds."""

from __future__ import annotations

import copy
import itertools
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..detectors import Detector, Verdict
from ..detectors.base import UndeclaredFieldError, check_needs, check_verdict, describe_undeclared
from ..detectors.build import DetectorSpec, bare_detector
from ..detectors.isolated import Isolated, IsolationError, is_foreign
from ..policies.card import DetectorCard
from ..receiver.epoch import Epoch, TracedEpoch
from .ages import can_fly, check_ages, check_stationary
from .contract import (
    ContractTrial,
    Record,
    check_described,
    check_memory,
    explain_read_only,
    require_contract,
    require_fresh,
    run_trial,
    same_bits,
)
from .epochs import (
    CHANNELS,
    COORDINATES,
    Script,
    SteadyEpochs,
    engine_script,
    position_script,
    trying_script,
)

WINDOW_EPOCHS = 120
"""Longest window that is looked for; at 0.5 s an epoch."""
SIZES = (1.0, 30.0)
"""Of what is added to innovations, in standard deviations: small and large."""
UNDECLARED_EPOCHS = 2
"""Memory or silence that needs no word, such as that of a difference of neighbours."""


def check_detector(detector: DetectorSpec, *, stationary: bool = False) -> None:
    """Check that a detector keeps its contract: silent, returning None, when all holds.

    It is bound, fed with epochs of a run of the default scenario and with made-up ones (satellites
    that come and go, or none at all; unequal intervals; no innovation, and a huge one); where it
    `measures` positions, with made-up ones of two and of three coordinates instead, and where it
    measures any, with all of them.  One that needs a model of the victim's errors has epochs of the
    run alone.  It has to show that

    - it cites a paper, states its scope and what it measures, and needs what an epoch can have;
    - it reads no optional field of an epoch that its `needs` does not name;
    - verdicts have the right shapes and types, and are finite; weights lie within 0 and 1; an
      invisible channel has statistic 0, no alarm and weight 1; there is an alarm where the
      statistic exceeds the threshold, unless `alarm_is_state`;
    - it neither writes to an epoch nor stores it, nor writes to an array that it returned;
    - a receiver's verdicts don't depend on the batch that it is in, bit for bit;
    - it draws no random numbers, and all that it remembers is in its `memory`, so that some
      receivers can be reset, moved, copied and pickled;
    - its settings fit into JSON, and `bind` sets `silent_epochs` and `memory_epochs` where it has a
      window of up to 60 s.  An average that fades, and a longer window, are not found.

    Parameters
    ----------
    detector : Detector, str, mapping or type
        What `make_detector` takes, or a class that needs no settings; an ``.onnx`` file needs no
        threshold on its card.  The object itself is left as it is.
    stationary : bool
        Whether what it finds must not depend on the time since it was switched on, either: at 3, 10
        and 30 min, by `check_stationary`, and by `check_ages` where a tightly coupled receiver has
        what it judges.  That takes some 20 s.

    Raises
    ------
    AssertionError
        Says what was expected, what came, and how to mend it; or where `judge` failed or warned.

    Examples
    --------
    >>> from spoofgym.testing import check_detector
    >>> check_detector({"name": "ewma", "smoothing": 0.2})
    """
    unbound = bare_detector(detector)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        for trial in check_verdicts(unbound):
            run_trial(trial)
        if unbound.card is None and not unbound.needs_model:
            _check_windows(unbound)
    if stationary:
        if not unbound.needs_model:
            check_stationary(unbound)
        if can_fly(unbound):
            check_ages(unbound)


def check_verdicts(unbound: Detector) -> list[_DetectorTrial]:
    """Check what no run can do without: what a detector declares, and its verdicts on all epochs.
    Returns the trials of the rest."""
    _check_declarations(unbound)
    scripts = list_scripts(unbound.measures, unbound.card)
    if unbound.needs_model:
        scripts = [each for each in scripts if each.context.model is not None]
    trials = [_DetectorTrial(unbound, each) for each in scripts]
    for trial in trials:
        _check_bound_again(trial)
        _check_verdicts(trial)
    return trials


def list_scripts(measures: str, card: DetectorCard | None = None) -> list[Script]:
    """Epochs of what a detector measures; for one in a file with as many slots as it was made for:
    a run is left out that has another number of them."""
    scripts = []
    if measures != "position" and card is None:
        scripts += [engine_script(), trying_script()]
    elif measures != "position" and card is not None:
        run = engine_script()
        made_for = card.channels or run.context.channels
        interval_s = card.interval_s or run.context.epoch_interval_s
        fit = [run] if made_for == run.context.channels else []
        for each in (*fit, trying_script(max(made_for, CHANNELS))):
            context = each.context._replace(epoch_interval_s=interval_s)
            scripts.append(each._replace(context=context))
    if measures != "satellites":
        scripts += [position_script(m) for m in COORDINATES]
    return scripts


class _DetectorTrial(ContractTrial[Detector]):
    """A detector that judges the epochs of a script."""

    word, call = "detector", "judge"

    def __init__(self, unbound: Detector, script: Script) -> None:
        self.unbound, self.script = unbound, script
        self.receivers, self.turns = script.context.receivers, len(script.epochs)

    def bind(self, rows: NDArray[np.intp]) -> Detector:
        bound = copy.deepcopy(self.unbound)
        context = self.script.context
        noise = context.noise_variance.copy()
        try:
            bound.bind(context._replace(receivers=len(rows), noise_variance=noise))
        except AttributeError as error:
            if hasattr(bound, "memory"):
                raise
            raise AssertionError(
                f"`bind` finds no memory ({error}); call `super().bind(context)` first, then "
                "`self.memory.declare(name, initial)`"
            ) from error
        return bound

    def reset(self, bound: Detector, mask: NDArray[np.bool_] | None) -> None:
        bound.reset(mask)

    def judge(
        self, bound: Detector, number: int, rows: NDArray[np.intp]
    ) -> tuple[Verdict, dict[str, NDArray[Any]]]:
        """Verdict on a read-only copy of an epoch, and the arrays of that copy."""
        given = self.script.epoch(number, rows, bound.needs)
        own = {name: array.copy() for name, array in given.items()}
        seen = {name: array.view() for name, array in own.items()}
        for view in seen.values():
            view.flags.writeable = False
        where = f"in epoch {number} of {self.script.name}"
        with _name_failure(bound, where, own["visible"]), explain_read_only("detector", "epoch"):
            verdict = judge_with_trace(bound, TracedEpoch(**seen))
        for name, array in own.items():
            require_contract(
                same_bits(array, given[name]),
                f"the detector has changed `epoch.{name}`, which others see as well; copy the "
                "array first",
            )
        return verdict, own

    def turn(self, bound: Detector, number: int, rows: NDArray[np.intp], spoil: bool) -> Record:
        verdict, own = self.judge(bound, number, rows)
        record = {name: None if a is None else a.copy() for name, a in verdict._asdict().items()}
        if spoil:
            for array in own.values():
                array[...] = ~array if array.dtype == np.bool_ else np.nan
        return record


@contextmanager
def _name_failure(detector: Detector, where: str, visible: NDArray[np.bool_]) -> Iterator[None]:
    """Say which class fails or warns, and at what."""
    try:
        yield
    except (AssertionError, IsolationError):
        raise
    except Exception as error:  # of any kind, since it is another's code
        kind, seen = detector.label or type(detector).__name__, visible.sum(axis=1)
        raise AssertionError(
            f"`{kind}.judge` failed {where}, of {len(seen)} receivers that see {seen.min()} to "
            f"{seen.max()} satellites: {type(error).__name__}: {error}"
        ) from error


def judge_with_trace(detector: Detector, epoch: TracedEpoch) -> Verdict:
    try:
        verdict = detector.judge(epoch)
    except UndeclaredFieldError as error:  # of a detector in a pool
        raise AssertionError(str(error)) from error
    except Exception as error:
        message = describe_undeclared(detector, epoch)
        if message:
            raise AssertionError(message) from error
        raise
    message = describe_undeclared(detector, epoch)
    require_contract(not message, message)
    return verdict


def _check_declarations(detector: Detector) -> None:
    check_described(detector, "detector")
    kind, paper = detector.label or type(detector).__name__, detector.paper
    outside = is_foreign(detector) or isinstance(detector, Isolated)
    require_contract(
        isinstance(paper, str) and (bool(paper.strip()) or (outside and not paper)),
        f"`{kind}.paper` must be a key in references.bib, for a classic too, got {paper!r}",
    )
    require_contract(
        detector.scope in ("channel", "receiver"),
        f"`{kind}.scope` must be 'channel' (c = n) or 'receiver' (c = 1), got {detector.scope!r}",
    )
    require_contract(
        detector.measures in ("satellites", "position", "any"),
        f"`{kind}.measures` must be 'satellites', 'position' or 'any', got {detector.measures!r}",
    )
    require_contract(
        isinstance(detector.oracle, bool),
        f"`{kind}.oracle` must be True or False, got {detector.oracle!r}",
    )
    try:
        check_needs(detector)
    except ValueError as error:
        raise AssertionError(str(error)) from error


def _check_bound_again(trial: _DetectorTrial) -> None:
    bound = trial.bind(np.arange(trial.receivers))
    check_memory(bound, trial.receivers, "detector")
    bound.bind(trial.script.context._replace(receivers=1))
    check_memory(bound, 1, "detector")


def _check_verdicts(trial: _DetectorTrial) -> None:
    everyone = np.arange(trial.receivers)
    bound = trial.bind(everyone)
    verdicts, copies = [], []
    for number in range(trial.turns):
        verdict, own = trial.judge(bound, number, everyone)
        check_memory(bound, trial.receivers, "detector")
        try:
            check_verdict(verdict, bound, trial.script.epochs[number])
        except (TypeError, ValueError) as error:
            raise AssertionError(f"on {trial.script.name}, {error}") from error
        _check_arrays(bound, verdict, own)
        _check_invisible(bound, trial.script, number, verdict)
        _check_alarm(bound, trial.script, number, verdict)
        verdicts.append(verdict)
        copies.append(copy.deepcopy(verdict))
    for verdict, copied in zip(verdicts, copies, strict=True):
        for name in Verdict._fields:
            require_contract(
                same_bits(getattr(verdict, name), getattr(copied, name)),
                f"the verdict's `{name}` has changed while the detector went on; return a new "
                "array at every epoch",
            )
    require_contract(
        len({verdict.weights is None for verdict in verdicts}) == 1,
        "`weights` must be an array at every epoch or None at every epoch, got both; a detector "
        "that does not weigh anything returns ones",
    )


def _check_arrays(detector: Detector, verdict: Verdict, own: Mapping[str, NDArray[Any]]) -> None:
    owners = {f"`epoch.{name}`": array for name, array in own.items()}
    owners |= {f"`memory[{name!r}]`": array for name, array in detector.memory.items()}
    for name, array in verdict._asdict().items():
        if array is None and name == "weights":
            continue
        require_fresh(f"the verdict's `{name}`", array, owners, "the next epoch")


def _check_invisible(detector: Detector, script: Script, number: int, verdict: Verdict) -> None:
    if not script.context.channels:
        return
    epoch = script.epochs[number]
    absent, where = ~epoch.visible, f"on {script.name}, at {epoch.time[0]:g} s,"
    if detector.scope == "channel":
        require_contract(
            not verdict.statistic[absent].any(),
            f"{where} the statistic of a channel that isn't visible must be 0, got "
            f"{np.abs(verdict.statistic[absent]).max(initial=0.0):g}; "
            "`statistic[~epoch.visible] = 0.0`",
        )
        require_contract(
            not verdict.alarm[absent].any(),
            f"{where} a channel that isn't visible must not alarm; `alarm &= epoch.visible`",
        )
    if verdict.weights is not None:
        weights = verdict.weights[np.hstack([absent, absent])]
        require_contract(
            bool((weights == 1.0).all()),
            f"{where} the weights of a channel that isn't visible must be 1, of pseudorange and "
            f"range rate, got {weights.min(initial=1.0):g}",
        )


def _check_alarm(detector: Detector, script: Script, number: int, verdict: Verdict) -> None:
    """Calibrations and figures compare the statistic with the threshold themselves."""
    if not detector.calibrates or detector.alarm_is_state:
        return
    statistic, threshold, alarm, _ = verdict
    wrong = (alarm & (statistic < threshold)) | (~alarm & (statistic > threshold))
    if number < detector.silent_epochs:
        wrong &= alarm
    for b, c in np.argwhere(wrong)[:1]:
        require_contract(
            False,
            f"on {script.name}, in epoch {number}, `alarm` must be whether the "
            f"statistic exceeds the threshold, got {alarm[b, c]} with {statistic[b, c]:g} and "
            f"{threshold[b, c]:g}; `compare(statistic, threshold)` makes such a verdict, and "
            "`alarm_is_state` is for flags that stay up",
        )


def _check_windows(unbound: Detector) -> None:
    """A window ends the influence of the past, or a silence, at the same epoch after a reset
    whatever the innovations are. The memory of a cumulative sum depends on them: no window."""
    forgets, firsts, steady = [], [], SteadyEpochs.of(unbound, 3)
    for seed, size in enumerate(SIZES):
        epochs = _shake(steady, size, np.random.default_rng(seed))
        bound, young = _judge_all(unbound, steady, epochs[WINDOW_EPOCHS:])
        _, old = _judge_all(unbound, steady, epochs)
        firsts = [_first_alarm(verdicts) for verdicts in (young, old)]
        forgets.append(_count_differing(young, old[WINDOW_EPOCHS:]))
    kind = unbound.label or type(unbound).__name__
    silent, (early, late) = bound.silent_epochs, firsts
    require_contract(
        silent <= min(firsts) or min(firsts) == WINDOW_EPOCHS,
        f"`{kind}.silent_epochs` is {silent}, but there is an alarm after {min(firsts)} epochs",
    )
    require_contract(
        early != late or early == WINDOW_EPOCHS or early <= silent + UNDECLARED_EPOCHS,
        f"{kind} raises no alarm in the first {early} epochs after a reset, however large the "
        f"innovations; set `self.silent_epochs = {early}` in `bind`, from its settings, so that a "
        "timeline that is too short for it is refused",
    )
    least, most = sorted(forgets)
    require_contract(
        bound.memory_epochs > 0
        or least <= UNDECLARED_EPOCHS
        or most == WINDOW_EPOCHS
        or most > least + 1,
        f"{kind} has a window: what it saw before no longer matters after {most + 1} epochs; set "
        f"`self.memory_epochs = {most + 1}` in `bind`, from its settings, so that there is a "
        "warning where a timeline is too short to fill it",
    )


def _shake(steady: SteadyEpochs, size: float, rng: np.random.Generator) -> list[Epoch]:
    """Steady epochs with innovations of either sign added; of a measured position, to it, too."""
    shaken = []
    for epoch in itertools.islice(steady, 2 * WINDOW_EPOCHS):
        n, shape = epoch.visible.shape[1], epoch.innovation.shape
        shift = size * rng.choice([-1.0, 1.0], shape) * rng.uniform(1.0, 2.0, shape)
        shift *= np.sqrt(epoch.innovation_variance) * (epoch.innovation != 0.0)
        moved = epoch._replace(innovation=epoch.innovation + shift)
        if n:
            ranges = np.array(epoch.pseudorange) + shift[:, :n]
            rates = np.array(epoch.range_rate) + shift[:, n:]
            moved = moved._replace(pseudorange=ranges, range_rate=rates)
        else:
            moved = moved._replace(gnss_position=np.array(epoch.gnss_position) + shift)
        shaken.append(moved)
    return shaken


def _judge_all(
    unbound: Detector, steady: SteadyEpochs, epochs: Sequence[Epoch]
) -> tuple[Detector, list[Verdict]]:
    bound = copy.deepcopy(unbound)
    bound.bind(steady.context)
    verdicts = []
    for number, epoch in enumerate(epochs):
        with _name_failure(bound, f"in epoch {number} of a steady run", epoch.visible):
            verdicts.append(bound.judge(epoch))
    return bound, verdicts


def _first_alarm(verdicts: Sequence[Verdict]) -> int:
    """Epochs before the first alarm of any receiver, `WINDOW_EPOCHS` at most."""
    alarms = (k for k, verdict in enumerate(verdicts) if verdict.alarm.any())
    return min(next(alarms, WINDOW_EPOCHS), WINDOW_EPOCHS)


def _count_differing(one: Sequence[Verdict], other: Sequence[Verdict]) -> int:
    """Epochs after which two statistics are the same but for rounding."""
    a, b = (np.array([verdict.statistic for verdict in each]) for each in (one, other))
    differ = (np.abs(a - b) > 1e-6 * np.abs(b).max()).any(axis=(1, 2))
    return int(np.flatnonzero(differ).max(initial=-1)) + 1
