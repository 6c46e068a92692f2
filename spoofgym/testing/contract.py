"""Shared checks."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import random
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..core.memory import Memory
from ..core.settings import describe


def require_contract(holds: bool | np.bool_, message: str) -> None:
    if not holds:
        raise AssertionError(message)


def check_described(subject: Any, word: str) -> None:
    """Settings of a dataclass can be written into results."""
    if dataclasses.is_dataclass(subject):
        try:
            describe(subject)
        except (TypeError, ValueError) as error:
            raise AssertionError(
                f"the settings of the {word} must fit into JSON, where results are found by them: "
                f"{error}"
            ) from error


def same_bits(first: NDArray[Any] | None, second: NDArray[Any] | None) -> bool:
    if first is None or second is None:
        return first is None and second is None
    alike = first.shape == second.shape and first.dtype == second.dtype
    return alike and first.tobytes() == second.tobytes()


def first_difference(first: NDArray[Any] | None, second: NDArray[Any] | None) -> str:
    """Where two arrays differ first, for messages: ``"[2, 0]: 1.0 and 1.5"``."""
    if first is None or second is None or first.shape != second.shape:
        shapes = ["None" if a is None else f"shape {a.shape}" for a in (first, second)]
        return " and ".join(shapes)
    both_nan = np.isnan(first) & np.isnan(second)
    differ = np.argwhere(~((first == second) | both_nan))
    if not len(differ):
        return f"types {first.dtype} and {second.dtype}, or the sign of a zero"
    index = tuple(int(i) for i in differ[0])
    return f"{list(index)}: {first[index]} and {second[index]}"


def require_fresh(
    what: str, array: NDArray[Any], owners: dict[str, NDArray[Any]], until: str
) -> None:
    """Raise when an array that was handed out shares memory with one of `owners`, by name."""
    for owner, other in owners.items():
        require_contract(
            not np.may_share_memory(array, other),
            f"{what} is (part of) {owner}, which changes with {until}; return a copy",
        )


@contextmanager
def explain_read_only(word: str, given: str) -> Iterator[None]:
    try:
        yield
    except (ValueError, TypeError) as error:
        if "read-only" not in str(error) and "readonly" not in str(error):
            raise
        raise AssertionError(
            f"the {word} writes into its {given}, which is read-only ({error}); copy the array "
            "first"
        ) from error


@contextmanager
def refuse_global_random(word: str) -> Iterator[None]:
    before = random.getstate(), _numpy_state()
    yield
    require_contract(
        (random.getstate(), _numpy_state()) == before,
        f"the {word} uses the global random numbers of `random` or `numpy.random`, which makes "
        "runs depend on each other; it must not draw random numbers at all",
    )


def _numpy_state() -> tuple[Any, ...]:
    name, keys, *rest = np.random.get_state(legacy=True)  # noqa: NPY002 - only looked at
    return name, np.asarray(keys).tobytes(), *rest


Record = dict[str, NDArray[Any] | None]
"""What one turn brought about: arrays with a leading axis of receivers."""
MANY = 33  # receivers of a large batch: whole vectors of the processor, and a remainder
KEEP = "keep everything in arrays declared by `self.memory.declare` in `bind`"


class Remembering(Protocol):
    """Anything with a memory."""

    memory: Memory


T = TypeVar("T", bound=Remembering)


class ContractTrial(ABC, Generic[T]):
    """A subject, and the turns that it is tried with.  `call`: its method that takes a turn."""

    word: str
    call: str
    receivers: int
    turns: int

    @abstractmethod
    def bind(self, rows: NDArray[np.intp]) -> T:
        """Bind a copy of the subject to some of the receivers."""

    @abstractmethod
    def turn(self, bound: T, number: int, rows: NDArray[np.intp], spoil: bool) -> Record:
        """Let a subject that is bound to as many receivers as there are rows take one turn."""

    def reset(self, bound: T, mask: NDArray[np.bool_] | None) -> None:
        bound.memory.reset(mask)

    def play(
        self, bound: T, rows: NDArray[np.intp], turns: range, *, spoil: bool = False
    ) -> list[Record]:
        records = []
        for number in turns:
            records.append(self.turn(bound, number, rows, spoil))
            check_memory(bound, len(rows), self.word)
        return records


def run_trial(trial: ContractTrial[T]) -> list[Record]:
    """Check what does not depend on the purpose of the subject."""
    everyone, turns = np.arange(trial.receivers), range(trial.turns)
    bound = trial.bind(everyone)
    check_memory(bound, trial.receivers, trial.word)
    records = trial.play(bound, everyone, turns)
    with refuse_global_random(trial.word):
        again = trial.play(trial.bind(everyone), everyone, turns)
    _require_same(
        records,
        again,
        f"When all is done again, the {trial.word} must do the same: no random numbers, no clock "
        "time, nothing stored in the class or the module.",
    )
    _require_same(
        records,
        trial.play(trial.bind(everyone), everyone, turns, spoil=True),
        f"What the {trial.word} is given is valid during `{trial.call}` only, and overwritten "
        "afterwards; copy what you keep into `self.memory`.",
    )
    _check_batches(trial, records)
    _check_reset(trial, records)
    _check_moved_rows(trial, records)
    _check_copies(trial, records)
    return records


def check_memory(subject: Remembering, receivers: int, word: str) -> None:
    memory = getattr(subject, "memory", None)
    if not isinstance(memory, Memory):
        raise AssertionError(
            f"after `bind` the {word} must have a `memory` made by the base class, got {memory!r}; "
            "call `super().bind(context)` first"
        )
    require_contract(
        memory.receivers == receivers,
        f"the memory of the {word} must be of {receivers} receivers, got {memory.receivers}; make "
        "it again in every `bind`, by `super().bind(context)`",
    )
    for name, array in memory.items():
        if name not in memory.declared:
            raise AssertionError(
                f"the {word} keeps {name!r} in its memory without having declared it, so that no "
                f"reset restores it; start with `self.memory.declare({name!r}, ...)` in `bind`"
            )
        want = memory.declared[name]
        holds = isinstance(array, np.ndarray) and (array.shape, array.dtype) == (
            want.shape,
            want.dtype,
        )
        require_contract(
            holds,
            f"memory {name!r} of the {word} was declared as {want.dtype} of shape {want.shape} and "
            f"has become {getattr(array, 'dtype', type(array))} of shape "
            f"{getattr(array, 'shape', None)}; keep shape and type",
        )


def _require_same(
    expected: Sequence[Record],
    got: Sequence[Record],
    message: str,
    rows: NDArray[np.intp] | slice = slice(None),
    among: NDArray[np.intp] | slice = slice(None),
) -> None:
    """Raise where records differ: `rows` of the expected ones, and `among` of the others."""
    for k, (want, record) in enumerate(zip(expected, got, strict=True)):
        for name in want:
            a, b = _select_rows(want[name], rows), _select_rows(record[name], among)
            require_contract(
                same_bits(a, b),
                f"{message} `{name}` of turn {k} differs at {first_difference(a, b)}.",
            )


def _select_rows(array: NDArray[Any] | None, rows: NDArray[np.intp] | slice) -> NDArray[Any] | None:
    return None if array is None else np.ascontiguousarray(array[rows])


def _check_batches(trial: ContractTrial[T], records: Sequence[Record]) -> None:
    batches = [np.array([row]) for row in range(trial.receivers)]
    for rows in (*batches, np.arange(MANY) % trial.receivers):
        _require_same(
            records,
            trial.play(trial.bind(rows), rows, range(trial.turns)),
            f"For the {trial.word}, a receiver must be the same, bit for bit, among {len(rows)} "
            f"and among {trial.receivers} receivers. Likely causes: receivers that mix, or state "
            f"outside `memory` ({KEEP}); or sums whose order depends on the batch (keep arrays "
            "C-contiguous with the receivers first, and write sums out instead of matrix products "
            "or `optimize=True`).",
            rows,
        )


def _check_reset(trial: ContractTrial[T], records: Sequence[Record]) -> None:
    everyone, half = np.arange(trial.receivers), trial.turns // 2
    early, late = range(half), range(half, trial.turns)
    fresh = trial.play(trial.bind(everyone), everyone, late)
    some = everyone % 2 == 0
    for mask in (some, None):
        bound = trial.bind(everyone)
        trial.play(bound, everyone, early)
        trial.reset(bound, None if mask is None else mask.copy())
        got = trial.play(bound, everyone, late)
        restarted = everyone if mask is None else everyone[mask]
        _require_same(
            fresh,
            got,
            f"After a reset the {trial.word} must be as it was after `bind`; {KEEP}.",
            restarted,
            restarted,
        )
        others = np.setdiff1d(everyone, restarted)
        _require_same(
            records[half:],
            got,
            f"A reset of some receivers must leave the others alone; {KEEP}.",
            others,
            others,
        )


def _check_moved_rows(trial: ContractTrial[T], records: Sequence[Record]) -> None:
    everyone, half = np.arange(trial.receivers), trial.turns // 2
    order = np.roll(everyone, 2)
    source, target = trial.bind(everyone), trial.bind(order)
    trial.play(source, everyone, range(half))
    trial.play(target, order, range(half, half + 1))  # some other past
    target.memory.copy_rows(everyone, source.memory, order)
    _require_same(
        records[half:],
        trial.play(target, order, range(half, trial.turns)),
        f"When the rows of its memory are moved to another batch, the {trial.word} must go on the "
        f"same; {KEEP}.",
        order,
    )


def _check_copies(trial: ContractTrial[T], records: Sequence[Record]) -> None:
    everyone, half = np.arange(trial.receivers), trial.turns // 2
    late = range(half, trial.turns)
    bound = trial.bind(everyone)
    trial.play(bound, everyone, range(half))
    ways = {"deep-copied": copy.deepcopy, "pickled": lambda x: pickle.loads(pickle.dumps(x))}
    copies = {way: _copy_subject(bound, trial.word, way, how) for way, how in ways.items()}
    for way, copied in {**copies, "copied and pickled": bound}.items():
        _require_same(
            records[half:],
            trial.play(copied, everyone, late),
            f"A {way} {trial.word} must go on as if it had not been; keep nothing in the class.",
        )


def _copy_subject(subject: T, word: str, way: str, how: Callable[[T], T]) -> T:
    try:
        return how(subject)
    except Exception as error:
        raise AssertionError(
            f"the {word} cannot be {way} ({type(error).__name__}: {error}), but environments copy "
            "it and send it to other processes; define its class at the top of a module, and leave "
            "what cannot be copied (files, sessions, lambdas) out by `__getstate__`"
        ) from error
