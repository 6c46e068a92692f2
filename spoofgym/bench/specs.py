"""What is run, in words: names with settings, read from text and written into results."""

from __future__ import annotations

import importlib
import inspect
import json
import re
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import PurePath
from typing import Any, TypeVar, cast

from .._describe import describe as describe
from .._describe import digest_of as digest_of
from .._registry import build, refuse_pickle
from ..detectors import DETECTORS, Detector, LearnedDetector, calibrated, zoo
from ..detectors.asked import made_by, spec_with_thresholds
from ..policies.onnx_file import SUFFIX

T = TypeVar("T")
Spec = dict[str, Any]
_WORDS = {"None": None, "True": True, "False": False}
_COMMAS = r",(?![^\[\]]*\])"
"""Commas between settings, not those within the brackets of a list."""


def campaign_digest(config: Mapping[str, Any]) -> str:
    """Digest of the configuration of a campaign, in which ONNX files are by content, not path."""
    outside = {_moved(name, digest): digest for name, digest in config["outside"].items()}
    return digest_of({**_without_folders(dict(config)), "outside": outside})


def _moved(name: str, digest: str) -> str:
    """Name of an outside source: of an ONNX file or its card without the folder."""
    path = PurePath(name)
    return f"{path.name}:{digest}" if path.suffix in (SUFFIX, ".json") else name


def _without_folders(value: Any) -> Any:
    """Settings with paths of ONNX files by their last part."""
    if isinstance(value, Mapping):
        return {key: _without_folders(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_folders(item) for item in value]
    return PurePath(value).name if isinstance(value, str) and value.endswith(SUFFIX) else value


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
        try:
            spec = json.loads(text)
        except json.JSONDecodeError as error:
            raise ValueError(f"{text!r} is not JSON: {error}") from error
        if not isinstance(spec.get("name"), str):
            raise ValueError(f'{text!r} must have a "name"')
        return dict(spec)
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
    if not equals or not setting.strip():
        raise ValueError(f"a setting is written `name=value`, got {text!r}{where}")
    return setting.strip(), _value(value.strip())


def _value(text: str) -> Any:
    """A JSON value, none, true or false in any case, or the text itself."""
    word = text.capitalize()
    if word in _WORDS:
        return _WORDS[word]
    for read in (json.loads, float):
        try:
            return read(text)
        except ValueError:
            continue
    return text


def load_class(path: str, base: Callable[..., T]) -> type[T]:
    """Class of a module that is not part of spoofgym.  `base`: what it must be derived from."""
    kind = cast("type[T]", base)  # abstract, which type[T] does not allow for
    module_name, _, name = path.partition(":")
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        raise ValueError(
            f"there is no module {error.name!r} for {path!r}; a setting is written `{path}=...`"
        ) from error
    found = getattr(module, name, None)
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
    if isinstance(spec, Mapping) and ":" in str(spec.get("name", "")):
        settings = dict(spec)
        refuse_pickle(spec["name"])
        kind = load_class(settings.pop("name"), base)
        try:
            return kind(**settings)
        except TypeError as error:
            raise ValueError(f"{word} {spec['name']!r}: {error}") from error
    return build(word, kinds, base, spec, more=more)


def make_judge(spec: Any) -> Detector:
    """Detector of a campaign, which may ask for its thresholds; the name may be ``module:Class``.
    One that asks for nothing has those of the default rate."""
    made = partial(make, "detector", DETECTORS, Detector, more=zoo.shipped())
    return made_by(made, spec, calibrated.DEFAULT_RATE)


def spec_of_judge(detector: Detector) -> Spec:
    if isinstance(detector, LearnedDetector):  # as it is, not as its card has it
        return {**_spec_of_detector(detector), "threshold_scale": 1.0}
    return spec_with_thresholds(detector, _spec_of_detector)


def _spec_of_detector(detector: Detector) -> Spec:
    """Name and all settings of a detector; a file also by its digest."""
    if isinstance(detector, LearnedDetector):
        return {**detector.spec, "sha256": detector.sha256}
    return spec_of("detector", DETECTORS, detector)


def spec_of(word: str, kinds: Mapping[str, type[Any]], thing: Any) -> Spec:
    """Name and all settings of an object, from which `make` makes an equal one."""
    kind = type(thing)
    registered = {cls: name for name, cls in kinds.items()}
    name = registered.get(kind, f"{kind.__module__}:{kind.__qualname__}")
    missing = [key for key in settings_of(kind) if not hasattr(thing, key)]
    if missing:
        raise TypeError(
            f"{word} {name!r} must keep its settings under their names, so that results can name "
            f"them; it has no {', '.join(map(repr, missing))}"
        )
    return {"name": name, **{key: describe(getattr(thing, key)) for key in settings_of(kind)}}


def settings_of(kind: Callable[..., Any]) -> dict[str, Any]:
    """Settings of a class or function, with their defaults. Returns default by name;
    `inspect.Parameter.empty` where there is none."""
    parameters = inspect.signature(kind).parameters.values()
    spread = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return {item.name: item.default for item in parameters if item.kind not in spread}


def label_of(spec: Spec, default: Spec | None) -> str:
    """Short name: what differs from the default settings is in brackets."""
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
