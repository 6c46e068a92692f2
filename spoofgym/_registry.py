"""Objects by name: one way to say which detector, attack or spoofer, and one way to be wrong."""

from __future__ import annotations

import copy
import dataclasses
import difflib
import inspect
import math
import numbers
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar, cast

import numpy as np

T = TypeVar("T")
PICKLES = (".zip", ".pkl", ".pickle", ".pt", ".pth", ".ckpt", ".pth.tar", ".joblib")
"""Endings of files of models that would have to be unpickled."""


def check_choice(
    word: str, value: str, valid: Iterable[str], renamed: Mapping[str, str] | None = None
) -> None:
    """Raise unless a name is one of the valid ones; `renamed`: new names by old ones."""
    names = sorted(valid)
    if value not in names:
        if renamed and value in renamed:
            raise ValueError(f"{word} {value!r} is now called {renamed[value]!r}")
        near = difflib.get_close_matches(str(value), names, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"unknown {word} {value!r}; valid: {', '.join(names)}{hint}")


def refuse_pickle(name: Any) -> None:
    """Raise where what is named is a file that would have to be unpickled."""
    if str(name).lower().endswith(PICKLES):
        raise ValueError(
            f"{name} is a pickled file, which is never opened, since it can run any code: export "
            "the model by spoofgym.export, or load it yourself and give the object"
        )


def _article(word: str) -> str:
    return "an" if word[0] in "aeiou" else "a"


def build(
    word: str,
    kinds: Mapping[str, type[T]],
    base: Callable[..., T],
    spec: Any,
    *,
    more: Iterable[str] = (),
) -> T:
    """Object by name, by name and settings, or a copy of an object. `spec`: a name; ``{"name": ...,
    "setting": value, ...}``; or an object, which is copied."""
    kind = cast("type[T]", base)  # abstract, which type[T] does not allow for
    if isinstance(spec, kind):
        return copy.deepcopy(spec)
    if isinstance(spec, str):
        spec = {"name": spec}
    if not isinstance(spec, Mapping) or not isinstance(spec.get("name"), str):
        names = {*kinds, *more}
        raise TypeError(
            f"{_article(word)} {word} is a name ({', '.join(sorted(names))}), a dict with a "
            f"`name`, or an "
            f"instance of {kind.__module__}.{kind.__qualname__}, got {spec!r}"
        )
    settings = dict(spec)
    name = settings.pop("name")
    if name not in kinds:
        refuse_pickle(name)
        check_choice(word, name, {*kinds, *more} - {name})
    known = dataclasses.fields(kinds[name])  # type: ignore[arg-type]
    valid = [field.name for field in known]
    for setting in settings:
        if setting not in valid:
            raise ValueError(
                f"{word} {name!r} has no setting {setting!r}; valid: {', '.join(valid) or 'none'}"
            )
    for field in known:
        missing = dataclasses.MISSING
        if field.default is field.default_factory is missing and field.name not in settings:
            raise ValueError(f"{word} {name!r} needs the setting {field.name!r}")
    check_plain_settings(kinds[name], settings)
    return kinds[name](**settings)


def check_plain_settings(kind: type, settings: Mapping[str, Any]) -> None:
    """Raise where a number or truth value is something else; ranges are for the class to check."""
    for field in dataclasses.fields(kind):
        if field.name not in settings:
            continue
        value, said = settings[field.name], getattr(field.type, "__name__", field.type)
        words = set(str(said).split(" | "))
        nothing = " or None" if "None" in words else ""
        words.discard("None")
        if value is None and nothing:
            continue
        truth = isinstance(value, bool | np.bool_)
        if words == {"bool"}:
            right, must = truth, "True or False"
        elif words == {"int"}:
            whole = isinstance(value, numbers.Real) and float(value).is_integer()
            right, must = whole and not truth, "a whole number"
        elif words == {"float"}:
            right, must = isinstance(value, numbers.Real) and not truth, "a number"
        else:
            continue
        if not right:
            raise ValueError(f"`{field.name}` must be {must}{nothing}, got {value!r}")


def build_record(
    word: str, kind: type[T], given: Any, defaults: Mapping[str, Any] | None = None
) -> T:
    """Record from its settings. `given`: settings by name; a record, which is handed back; None for
    no settings; `defaults`: settings that hold where `given` does not say them; those of the
    dataclass by default."""
    if isinstance(given, kind):
        return given
    if given is not None and not isinstance(given, Mapping):
        raise TypeError(
            f"`{word}` must be a dict of settings or an instance of "
            f"{kind.__module__}.{kind.__qualname__}, got {given!r}"
        )
    valid = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    settings = {**(defaults or {}), **(given or {})}
    for name in settings:
        if name not in valid:
            raise ValueError(f"`{word}` has no setting {name!r}; valid: {', '.join(valid)}")
    check_plain_settings(kind, settings)
    return kind(**settings)


def is_number(value: object) -> bool:
    """Whether a setting is a real number, and no truth value. Returns True for infinite ones and
    NaN, too."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool | np.bool_)


def check_finite(name: str, value: Any, bound: str = "") -> None:
    """Raise unless a setting is a finite number within a `bound`, ``"> 0"`` or ``">= 0"``."""
    good = is_number(value) and math.isfinite(float(value))
    if good and bound:
        good = value > 0 if bound == "> 0" else value >= 0
    if not good:
        must = f"finite and {bound}" if bound else "a finite number"
        raise ValueError(f"`{name}` must be {must}, got {value!r}")


def check_truth(name: str, value: Any) -> None:
    """Raise unless a setting is True or False."""
    if value is not True and value is not False:
        raise ValueError(f"`{name}` must be True or False, got {value!r}")


def whole_number(name: str, value: Any, least: int = 0) -> int:
    """A count or a seed as Python's own int, also of NumPy's; raises unless it is at least `least`.
    `name` is how the message names it, with its quotes."""
    whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not whole or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    return int(value)


def check_keywords(
    whose: Callable[..., Any] | str, given: Iterable[str], valid: Iterable[str]
) -> None:
    """Raise unless keyword arguments are known, as Python does where they have no ``**``."""
    names = {*valid}
    if not isinstance(whose, str):
        own = inspect.signature(whose).parameters.values()
        names |= {each.name for each in own if each.kind is not each.VAR_KEYWORD}
        whose = whose.__name__
    for name in given:
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise TypeError(
                f"{whose} has no argument {name!r}; valid: {', '.join(sorted(names))}{hint}"
            )
