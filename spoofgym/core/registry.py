"""Objects by name or spec, checked settings, labels."""

from __future__ import annotations

import copy
import dataclasses
import difflib
import importlib
import inspect
import numbers
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any, TypeVar, cast

import numpy as np

from .reading import FileError, parse_json
from .settings import describe, list_written

T = TypeVar("T")
# Endings of files of models that would have to be unpickled.
PICKLES = (".zip", ".pkl", ".pickle", ".pt", ".pth", ".ckpt", ".pth.tar", ".joblib")


def require(good: object, message: str) -> None:
    if not good:
        raise ValueError(message)


SHOWN, LONGEST = 200, 10_000
"""Characters of a text that a message repeats, and of a name and settings that are no JSON."""


def suggest_name(value: object, names: Iterable[str]) -> str:
    """End of a message: which of the names is nearly the one that was given."""
    near = difflib.get_close_matches(str(value)[:SHOWN], list(names), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def check_choice(word: str, value: str, valid: Iterable[str]) -> None:
    """Raise unless a name is one of the valid ones."""
    names = sorted(valid)
    if value not in names:
        hint = suggest_name(value, names)
        given = repr(value)[:SHOWN]
        raise ValueError(f"unknown {word} {given}; valid: {', '.join(names)}{hint}")


def refuse_pickle(name: Any) -> None:
    require(
        not str(name).lower().endswith(PICKLES),
        f"{name} is a pickled file, which is never opened, since it can run any code: export "
        "the model by spoofgym.export, or load it yourself and give the object",
    )


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
            f"{'an' if word[0] in 'aeiou' else 'a'} {word} is a name "
            f"({', '.join(sorted(names))}), a dict with a `name`, or an "
            f"instance of {kind.__module__}.{kind.__qualname__}, got {spec!r}"
        )
    settings = dict(spec)
    name = settings.pop("name")
    if name not in kinds:
        refuse_pickle(name)
        check_choice(word, name, {*kinds, *more} - {name})
    return _construct(f"{word} {name!r}", kinds[name], settings)


def _construct(what: str, kind: type[T], settings: Mapping[str, Any]) -> T:
    """Record of a kind, after a check that its settings are known, and there."""
    known = {field.name: field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for name in settings:
        require(
            name in known, f"{what} has no setting {name!r}; valid: {', '.join(known) or 'none'}"
        )
    for name, field in known.items():
        if field.default is field.default_factory is dataclasses.MISSING and name not in settings:
            raise ValueError(f"{what} needs the setting {name!r}")
    return kind(**settings)


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
    return _construct(f"`{word}`", kind, {**(defaults or {}), **(given or {})})


def is_number(value: object) -> bool:
    """Whether a setting is a real number, and no truth value. Returns True for infinite ones and
    NaN, too."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool | np.bool_)


def check_truth(name: str, value: Any) -> None:
    require(value is True or value is False, f"`{name}` must be True or False, got {value!r}")


def whole_number(name: str, value: Any, least: int = 0) -> int:
    """A count or a seed as Python's own int, also of NumPy's; raises unless it is at least `least`.
    `name` is how the message names it, with its quotes."""
    whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not whole or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    return int(value)


def refuse_overrides(decider: str, names: Iterable[str]) -> None:
    if given := ", ".join(names):
        raise ValueError(f"{given} can't be given with {decider}, which decides it")


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
            valid, hint = ", ".join(sorted(names)), suggest_name(name, names)
            raise TypeError(
                f"{whose} got an unexpected keyword argument {name!r}; valid: {valid}{hint}"
            )


Spec = dict[str, Any]
_WORDS = {"None": None, "True": True, "False": False}
_COMMAS = r",(?![^\[\]]*\])"  # commas between settings, not those within the brackets of a list


def parse_spec(text: str) -> Spec:
    """Name and settings from the text of a command line.

    Examples
    --------
    >>> parse_spec("ewma:smoothing=0.2,weight_scale=none")
    {'name': 'ewma', 'smoothing': 0.2, 'weight_scale': None}
    >>> parse_spec("aime:windows_s=[5,25],signals=both")
    {'name': 'aime', 'windows_s': [5, 25], 'signals': 'both'}
    """
    text = text.strip()
    if text.startswith("{"):
        spec = parse_json(text, repr(text[:SHOWN]))
        if not isinstance(spec.get("name"), str):
            raise ValueError(f'{text!r} must have a "name"')
        return dict(spec)
    if len(text) > LONGEST:
        raise ValueError(f"a name and settings have at most {LONGEST} characters, got {len(text)}")
    name, _, rest = text.rpartition(":")
    if not name or "=" not in rest:
        name, rest = text, ""
    spec = {"name": name}
    for part in filter(None, re.split(_COMMAS, rest)):
        setting, value = parse_setting(part, f" in {text!r}")
        spec[setting] = value
    return spec


def parse_setting(text: str, where: str = "") -> tuple[str, Any]:
    """One setting and its value, from ``name=value``.

    Examples
    --------
    >>> parse_setting('domain={"start_s": [0, 60]}')
    ('domain', {'start_s': [0, 60]})
    """
    setting, equals, value = text.partition("=")
    require(equals and setting.strip(), f"a setting is written `name=value`, got {text!r}{where}")
    return setting.strip(), _value(value.strip())


def _value(text: str) -> Any:
    """A JSON value, none, true or false in any case, or the text itself."""
    word = text.capitalize()
    if word in _WORDS:
        return _WORDS[word]
    with suppress(FileError):
        return parse_json(text, "a value", object)
    try:
        return float(text)
    except ValueError:
        return text


def describe_error(error: Exception) -> str:
    """An error of another's code in words: messages of lookups alone say little."""
    plain = isinstance(error, TypeError | ValueError)
    return str(error) if plain else f"{type(error).__name__}: {error}"


def load_class(path: str, base: Callable[..., T], names: Iterable[str] = ()) -> type[T]:
    """Class from ``module:Class``; `names`: those that have settings of their own."""
    if "=" in path:
        raise ValueError(f"{path!r} is no name; write a mapping: {parse_spec(path)!r}")
    kind = cast("type[T]", base)  # abstract, which type[T] does not allow for
    module_name, _, name = path.partition(":")
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        hint = f"Python looked in {os.path.abspath(sys.path[0])} and the rest of `sys.path`"
        if module_name in {*names}:
            hint = f"a setting is written `{path}=...`"
        raise ValueError(f"there is no module {error.name!r} for {path!r}; {hint}") from error
    except Exception as error:  # of any kind, since it is another's code
        raise ValueError(
            f"the module of {path!r} raises {type(error).__name__} when it is imported: {error}"
        ) from error
    found = getattr(module, name, None)
    if found is None:
        hint = suggest_name(name, vars(module))
        raise ValueError(f"{path!r}: the module {module_name} has no {name!r}{hint}")
    if not (isinstance(found, type) and issubclass(found, kind)):
        raise ValueError(
            f"{path!r} must be a class derived from {kind.__module__}.{kind.__qualname__}"
        )
    return found


def make(
    word: str,
    kinds: Mapping[str, type[T]],
    base: Callable[..., T],
    spec: Any,
    more: Iterable[str] = (),
) -> T:
    """Object by name and settings; the name may be ``module:Class``. `spec`: as `parse_spec`
    returns it, or an object, which is copied; `more`: other valid names."""
    if isinstance(spec, str):
        spec = {"name": spec}
    name = spec.get("name") if isinstance(spec, Mapping) else None
    if isinstance(name, str) and ":" in name:
        settings = dict(spec)
        refuse_pickle(name)
        kind = load_class(settings.pop("name"), base, [*kinds, *more])
        try:
            return kind(**settings)
        except (TypeError, LookupError, AttributeError) as error:
            raise ValueError(f"{word} {name!r}: {describe_error(error)}") from error
    return build(word, kinds, base, spec, more=more)


def build_spec(word: str, kinds: Mapping[str, type[Any]], thing: Any) -> Spec:
    kind = type(thing)
    registered = {cls: name for name, cls in kinds.items()}
    name = registered.get(kind, f"{kind.__module__}:{kind.__qualname__}")
    missing = [key for key in inspect_settings(kind) if not hasattr(thing, key)]
    if missing:
        raise TypeError(
            f"{word} {name!r} must keep its settings under their names, so that results can name "
            f"them; it has no {', '.join(map(repr, missing))}"
        )
    written = list_written(thing, inspect_settings(kind))
    return {"name": name, **{key: describe(getattr(thing, key)) for key in written}}


def inspect_settings(kind: Callable[..., Any]) -> dict[str, Any]:
    """Settings of a class or function, with their defaults. Returns default by name;
    `inspect.Parameter.empty` without one."""
    parameters = inspect.signature(kind).parameters.values()
    spread = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return {item.name: item.default for item in parameters if item.kind not in spread}


def format_label(spec: Spec, default: Spec | None) -> str:
    settings = {key: value for key, value in spec.items() if key != "name"}
    if default is not None:
        settings = {key: v for key, v in settings.items() if default.get(key, v) != v}
    parts = [
        "tuned" if value == "tuned" else f"{key}={_short(value)}" for key, value in settings.items()
    ]
    name = str(spec["name"]).rpartition(":")[2]
    return f"{name}({','.join(parts)})" if parts else name


def _short(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list) and value and all(isinstance(v, dict) for v in value):
        return "+".join(str(v.get("name", v)) for v in value)
    if isinstance(value, list) and len(value) > 3:
        return f"{len(value)} values"
    return f"{value:g}" if isinstance(value, float) else str(value)


def slug(label: str) -> str:
    return re.sub(r"[^A-Za-z0-9._=]+", "-", label).strip("-.")
