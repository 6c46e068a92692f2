"""Terms of observation, action, reward and end: small objects that make up an environment."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any

from ...core.reading import name_file, read_json, read_toml
from ...core.registry import build, check_choice
from ...core.settings import describe
from .action import ACTION_TERMS, ActionTerm
from .observation import OBSERVATION_TERMS, ObservationTerm
from .reward import REWARD_TERMS, RewardTerm
from .termination import END_TERMS, EndTerm

TERMS: dict[str, dict[str, type[Any]]] = {
    "observation": OBSERVATION_TERMS,
    "action": ACTION_TERMS,
    "reward": REWARD_TERMS,
    "end": END_TERMS,
}
"""Terms by kind and name; one's own may be added."""
_MEMBERS = {
    "observation": ("knowledge", "names", "bounds"),
    "action": ("names", "matrix"),
    "reward": ("name", "__call__"),
    "end": ("name", "truncates", "__call__"),
}
_Name = str | Mapping[str, Any]
ObservationSpec = _Name | PurePath | ObservationTerm | Sequence[_Name | ObservationTerm]
ActionSpec = _Name | PurePath | ActionTerm | Sequence[_Name | ActionTerm]
RewardSpec = _Name | PurePath | RewardTerm | Sequence[_Name | RewardTerm]
EndSpec = _Name | PurePath | EndTerm | Sequence[_Name | EndTerm]
SUFFIXES = (".json", ".toml")


class _Nothing:
    """No term is of this class, so that `build` makes all of them from names and settings."""


def make_terms(kind: str, spec: Any) -> tuple[Any, ...]:
    """Terms of one kind.

    Parameters
    ----------
    kind : {"observation", "action", "reward", "end"}
        The kind.
    spec : str, mapping, term, path or sequence of them
        A name in `TERMS`; ``{"name": ..., "setting": value, ...}``; an object; a list of these; or
        the path of a JSON or TOML file, whose key `kind` holds such a list.

    Returns
    -------
    tuple
        Terms, in the order given.

    Raises
    ------
    ValueError, TypeError
        When a kind, a name or a setting is unknown, or something is no term of this kind.

    Examples
    --------
    >>> make_terms("end", ["at-alarm", {"name": "at-displacement", "limit_m": 50.0}])
    (AtAlarm(), AtDisplacement(limit_m=50.0))
    """
    check_choice("kind of terms", kind, TERMS)
    file = None
    if isinstance(spec, PurePath) or (isinstance(spec, str) and spec.endswith(SUFFIXES)):
        file, spec = spec, _read_terms(kind, Path(spec))
    with name_file(file):
        several = spec if isinstance(spec, list | tuple) else (spec,)
        return tuple(_make(kind, each) for each in several)


def _make(kind: str, spec: Any) -> Any:
    if isinstance(spec, str) or (isinstance(spec, Mapping) and isinstance(spec.get("name"), str)):
        if isinstance(spec, Mapping):  # terms are frozen
            spec = {key: tuple(x) if isinstance(x, list) else x for key, x in spec.items()}
        return build(f"{kind} term", TERMS[kind], _Nothing, spec)
    lacking = [name for name in _MEMBERS[kind] if not hasattr(spec, name)]
    if isinstance(spec, type | Mapping) or lacking:
        why = "it is a class" if isinstance(spec, type) else f"it has no {', '.join(lacking)}"
        if isinstance(spec, Mapping):
            written_by = (
                "`spoofgym.envs.terms.describe_terms` gives the settings of an object with its name"
            )
            why = f"it has no `name`; {written_by}"
        raise TypeError(
            f"a term of kind {kind!r} is a name ({', '.join(sorted(TERMS[kind]))}), a dict with a "
            f"`name`, or an object; got {spec!r}: {why}"
        )
    return spec


def _read_terms(kind: str, path: Path) -> Any:
    try:
        content = read_json(path, object) if path.suffix == ".json" else read_toml(path)
    except OSError as error:
        if not isinstance(error, FileNotFoundError):
            raise ValueError(f"{str(path)!r} can't be read: {error}") from error
        raise ValueError(f"there is no file {str(path)!r} with {kind} terms") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{str(path)!r} can't be read: {error}") from error
    if not isinstance(content, Mapping):
        raise ValueError(f"{str(path)!r} must hold lists by kind; valid: {', '.join(TERMS)}")
    for key in content:
        check_choice(f"kind of terms in {str(path)!r}:", key, TERMS)
    if kind not in content:
        raise ValueError(
            f"{str(path)!r} has no {kind!r}; it has: {', '.join(content) or 'nothing'}"
        )
    return content[kind]


def describe_terms(kind: str, terms: Any) -> list[dict[str, Any]]:
    """Terms as `make_terms` takes them, JSON-able: a name and all settings of each.

    Parameters
    ----------
    kind : {"observation", "action", "reward", "end"}
        The kind.
    terms : str, mapping, term, path or sequence of them
        As `make_terms` takes them; a TypeError where one is not in `TERMS`.

    Returns
    -------
    list of dict
        In the order given.

    Examples
    --------
    >>> describe_terms("end", "at-alarm")
    [{'name': 'at-alarm'}]
    """
    names = {made: name for name, made in TERMS[kind].items()} if kind in TERMS else {}
    result = []
    for term in make_terms(kind, terms):
        if type(term) not in names:
            raise TypeError(
                f"{type(term).__qualname__} has no name among the {kind} terms; add it to "
                f"spoofgym.envs.terms.TERMS[{kind!r}] under one"
            )
        settings = {f.name: describe(getattr(term, f.name)) for f in dataclasses.fields(term)}
        result.append({"name": names[type(term)], **settings})
    return result
