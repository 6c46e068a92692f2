"""Objects by name: one way to say which detector, attack or spoofer, and one way to be wrong."""

from __future__ import annotations

import copy
import dataclasses
import difflib
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar, cast

T = TypeVar("T")


def check_choice(word: str, value: str, valid: Iterable[str]) -> None:
    """Raise unless a name is one of the valid ones.

    Parameters
    ----------
    word : str
        What is named, for the message.
    value : str
        The name.
    valid : iterable of str
        Valid names.

    Raises
    ------
    ValueError
        Lists the valid names, and the nearest one.
    """
    names = sorted(valid)
    if value not in names:
        near = difflib.get_close_matches(str(value), names, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"unknown {word} {value!r}; valid: {', '.join(names)}{hint}")


def settings_of(word: str, kind: type, given: Mapping[str, Any] | None) -> dict[str, Any]:
    """Keyword arguments of a dataclass; an unknown one is refused with the valid ones.

    Parameters
    ----------
    word : str
        What it is, for the message.
    kind : type
        The dataclass.
    given : mapping or None
        Settings by name; None for none.

    Returns
    -------
    dict
        A new one.

    Raises
    ------
    ValueError
        When a setting is unknown.
    """
    valid = [field.name for field in dataclasses.fields(kind)]
    settings = dict(given or {})
    for name in settings:
        if name not in valid:
            raise ValueError(f"{word} has no setting {name!r}; valid: {', '.join(valid)}")
    return settings


def record_of(word: str, kind: type[T], given: Mapping[str, Any] | T | None) -> T:
    """Record from its settings, or the record itself.

    Parameters
    ----------
    word : str
        What it is, for messages.
    kind : type
        The dataclass.
    given : mapping, record or None
        Settings by name, a record, or None for its defaults.

    Returns
    -------
    object
        Of this kind.

    Raises
    ------
    ValueError
        When a setting is unknown.
    """
    if isinstance(given, kind):
        return given
    return kind(**settings_of(word, kind, cast("Mapping[str, Any] | None", given)))


def build(word: str, kinds: Mapping[str, type[T]], base: Callable[..., T], spec: Any) -> T:
    """Object by name, by name and settings, or a copy of an object.

    Parameters
    ----------
    word : str
        What it is, for messages.
    kinds : mapping
        Dataclasses by name.
    base : type
        Their base class.
    spec : str, dict or object
        A name; ``{"name": ..., "setting": value, ...}``; or an object, which is copied.

    Returns
    -------
    object
        A new one.

    Raises
    ------
    ValueError
        When the name or a setting is unknown, the valid ones are listed; or a setting is missing.
    TypeError
        When `spec` is something else.
    """
    kind = cast("type[T]", base)  # abstract, which type[T] does not allow for
    if isinstance(spec, kind):
        return copy.deepcopy(spec)
    if isinstance(spec, str):
        spec = {"name": spec}
    if not isinstance(spec, Mapping) or not isinstance(spec.get("name"), str):
        raise TypeError(
            f"a {word} is a name ({', '.join(sorted(kinds))}), a dict with a `name`, or an "
            f"instance of {kind.__module__}.{kind.__qualname__}, got {spec!r}"
        )
    settings = dict(spec)
    name = settings.pop("name")
    check_choice(word, name, kinds)
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
    return kinds[name](**settings)
