"""Settings that are declared once: their bounds, units and meaning, where the field stands.

A record's class is decorated by `settings_record`, and its fields are made by `setting`.  From
these come the checks of a new record, the parameters of the docstring and the rows of listings.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import MISSING, dataclass, field
from functools import cache
from itertools import pairwise
from typing import Any, TypeVar, dataclass_transform

import numpy as np

from .registry import SHOWN, is_number, suggest_name
from .settings import NEWER, OMITTED

T = TypeVar("T")
NUMBERS = {"float": "number", "int": "whole number"}
SECTION = re.compile(r"^(Attributes|Returns|Raises|See Also|Notes|References|Examples)\n-+$", re.M)


@dataclass(frozen=True)
class Setting:
    """Declaration of a field: what is valid for it, its unit, and what it means.

    Limits hold for a number, or for every number of a list.
    """

    above: float | None = None
    least: float | None = None
    below: float | None = None
    most: float | None = None
    one_of: tuple[str, ...] = ()
    increasing: bool = False
    infinite: bool = False
    empty: bool = False
    unit: str = ""
    help: str = ""

    @property
    def has_limits(self) -> bool:
        return not (self.above is self.least is self.below is self.most is None)

    def check(self, name: str, value: Any, annotation: str) -> None:
        """Raise ValueError, with the name, the value and what is valid, unless a value is."""
        kinds = set(split_union(annotation))
        if (value is None and "None" in kinds) or self._is_valid(value, kinds):
            return
        hint = suggest_name(value, self.one_of)
        raise ValueError(
            f"`{name}` must be {self.valid(annotation)}, got {repr(value)[:SHOWN]}{hint}"
        )

    def _is_valid(self, value: Any, kinds: set[str]) -> bool:
        if not {*NUMBERS, "bool"} & kinds and not self.one_of and not parse_list_kinds(kinds):
            return True  # a record or a text, which its own class checks
        if "bool" in kinds and isinstance(value, bool | np.bool_):
            return True
        if isinstance(value, str):
            return value in self.one_of or (not self.one_of and "str" in kinds)
        if any(self._holds(value, whole=kind == "int") for kind in NUMBERS if kind in kinds):
            return True
        items = parse_list_kinds(kinds)
        if items and isinstance(value, Sequence | np.ndarray):
            return self._are_valid(list(value), items)
        return bool(kinds - {*NUMBERS, "bool", "str", "None"} - {f"tuple[{i}, ...]" for i in items})

    def _are_valid(self, values: list[Any], items: list[str]) -> bool:
        good = all(self._holds(each, whole="float" not in items) for each in values)
        ordered = not self.increasing or all(a < b for a, b in pairwise(values))
        return (bool(values) or self.empty) and good and ordered

    def _holds(self, value: Any, whole: bool) -> bool:
        """Whether a value is a number within the limits; `whole`: and a whole one."""
        if not is_number(value):
            return False
        try:
            size = float(value)
        except OverflowError:  # a whole number of hundreds of digits
            return False
        if math.isnan(size) or (math.isinf(size) and not self.infinite):
            return False
        if whole and not size.is_integer():
            return False
        return (
            (self.above is None or size > self.above)
            and (self.least is None or size >= self.least)
            and (self.below is None or size < self.below)
            and (self.most is None or size <= self.most)
        )

    def valid(self, annotation: str) -> str:
        """What is valid, in words, ``"a number above 0 and at most 1"``."""
        kinds = split_union(annotation)
        words = [f"a {self._numbers(kind)}" for kind in NUMBERS if kind in kinds]
        for item in parse_list_kinds(kinds):
            order = " in increasing order" if self.increasing else ""
            words.append(f"a list of {self._numbers(item, 's')}{order}")
        words += ["True or False"] if "bool" in kinds else []
        words += map(repr, self.one_of)
        words += ["None"] if "None" in kinds and words else []
        return f"{', '.join(words[:-1])} or {words[-1]}" if len(words) > 1 else "".join(words)

    def _numbers(self, kind: str, plural: str = "") -> str:
        """Valid numbers of a kind, without their article."""
        finite = kind == "float" and not self.infinite and not self.has_limits
        name = f"{'finite ' if finite else ''}{NUMBERS[kind]}{plural}"
        if self.least is not None and self.most is not None:
            return f"{name} from {self.least:.10g} to {self.most:.10g}"
        limits = {
            "above": self.above,
            "at least": self.least,
            "below": self.below,
            "at most": self.most,
        }
        parts = [f"{word} {limit:.10g}" for word, limit in limits.items() if limit is not None]
        joined = " and ".join(parts)
        return f"{name} {'of ' if joined.startswith('at') else ''}{joined}".rstrip()


def setting(
    *,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    one_of: Iterable[str] = (),
    increasing: bool = False,
    infinite: bool = False,
    empty: bool = False,
    unit: str = "",
    help: str = "",
    omitted: bool = False,
    newer: bool = False,
    **options: Any,
) -> Any:
    """Field of a record, with what is valid for it.

    Parameters
    ----------
    above, least, below, most : float or None
        Limits of a number, or of every number of a list: excluded (`above`, `below`) or included.
    one_of : iterable of str
        Words that are valid; beside numbers where the annotation names numbers, too.
    increasing : bool
        Whether a list must be in increasing order.
    infinite, empty : bool
        Whether infinity is valid, and whether an empty list is.
    unit : str
        Unit, ``"m/s"``.
    help : str
        What it means: a sentence or two, shown in docstrings and listings.
    omitted : bool
        Whether its default is not written down, because what is stored is older than the field.
    newer : bool
        The same for specs and the names of calibrations, too.
    **options : object
        Those of `dataclasses.field`: ``default``, ``default_factory``, ``kw_only``, ``hash``.

    Returns
    -------
    field : dataclasses.Field
        For the body of a class that `settings_record` decorates.
    """
    limits = (above, least, below, most)
    declared = Setting(*limits, tuple(one_of), increasing, infinite, empty, unit, help)
    left_out = NEWER if newer else OMITTED if omitted else {}
    return field(metadata={"setting": declared, **left_out}, **options)


@dataclass_transform(field_specifiers=(setting, field))
def settings_record(kind: type[T] | None = None, /, **options: bool) -> Any:
    """Dataclass whose settings are checked before its own `__post_init__`, and documented.

    Parameters
    ----------
    kind : type
        Class to decorate.
    **options : bool
        Those of `dataclasses.dataclass`.

    Returns
    -------
    kind : type
        Dataclass; its docstring has the parameters.
    """

    def build(kind: Any) -> Any:
        finish = getattr(kind, "__post_init__", None)

        def __post_init__(self: Any, *rest: Any) -> None:
            check_settings(self)
            if finish is not None:
                finish(self, *rest)

        kind.__post_init__ = __post_init__
        made = dataclass(**options)(kind)
        made.__doc__ = document(made)
        return made

    return build if kind is None else build(kind)


def check_settings(record: Any) -> None:
    """Raise ValueError unless all declared settings of a record are valid.

    Lists become tuples where the annotation says so, numbers of NumPy those of Python, and whole
    numbers ints, so that equal settings are stored alike.
    """
    for name, (declared, annotation) in list_declarations(type(record)).items():
        value = getattr(record, name)
        declared.check(name, value, annotation)
        plain = _as_plain(value, annotation)
        if plain is not value:
            object.__setattr__(record, name, plain)


def _as_plain(value: Any, annotation: str) -> Any:
    kinds = split_union(annotation)
    value = _to_python(value)
    if isinstance(value, list | np.ndarray) and any(kind.startswith("tuple[") for kind in kinds):
        return tuple(value.tolist() if isinstance(value, np.ndarray) else map(_to_python, value))
    if "int" in kinds and "float" not in kinds and isinstance(value, float):
        return int(value)
    return value


def _to_python(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def check_number(
    name: str,
    value: Any,
    *,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    whole: bool = False,
) -> None:
    """Raise ValueError, as a record does, unless an argument is a finite number within limits."""
    Setting(above, least, below, most).check(name, value, "int" if whole else "float")


def check_word(name: str, value: Any, valid: Iterable[str]) -> None:
    """Raise ValueError, as a record does, unless an argument is one of the valid words."""
    Setting(one_of=tuple(valid)).check(name, value, "str")


def list_declarations(kind: type) -> dict[str, tuple[Setting, str]]:
    """Declared settings of a record's class, and their annotations, by name."""
    return {
        each.name: (each.metadata["setting"], str(getattr(each.type, "__name__", each.type)))
        for each in dataclasses.fields(kind)
        if "setting" in each.metadata
    }


def document(kind: type) -> str:
    """Docstring of a record's class, with the parameters that its settings declare, and where the
    equations of a detector are."""
    text, paper = inspect.cleandoc(kind.__doc__ or ""), vars(kind).get("paper")
    lines = [line for each in dataclasses.fields(kind) for line in _document_field(each)]
    parts = [f"Equations: `{kind.__module__}`; source: `{paper}`, references.bib."] if paper else []
    parts += ["\n".join(["Parameters", "----------", *lines])] if lines else []
    following = SECTION.search(text)
    at = following.start() if following else len(text)
    return "\n\n".join([text[:at].rstrip(), *parts, text[at:]]).rstrip() + "\n"


def _document_field(each: dataclasses.Field[Any]) -> list[str]:
    """Lines of a parameter: name, type and default; meaning, unit and what is valid."""
    declared = each.metadata.get("setting")
    if declared is None or not each.init:
        return []
    annotation = str(getattr(each.type, "__name__", each.type))
    kinds = [kind for kind in split_union(annotation) if kind != "str" or not declared.one_of]
    words = " or ".join([*map(repr, declared.one_of), *kinds])
    default = "" if each.default is MISSING else f", default {each.default!r}"
    unit = f" [{declared.unit}]" if declared.unit else ""
    meaning = re.sub(r"(?=[.;:])|$", unit, declared.help, count=1)
    narrowed = declared.has_limits or declared.increasing or declared.infinite
    valid = f" Valid: {declared.valid(annotation)}." if narrowed else ""
    return [f"{each.name} : {words}{default}", *textwrap.wrap(meaning + valid, 92, **INDENT)]


INDENT: dict[str, Any] = {"initial_indent": "    ", "subsequent_indent": "    "}


@cache
def split_union(annotation: str) -> tuple[str, ...]:
    """Members of a union as it is written, ``"float | None"``."""
    return tuple(re.split(r" \| (?![^\[]*\])", annotation))


def parse_list_kinds(kinds: Iterable[str]) -> list[str]:
    """Kinds of number of which a member of a union is a tuple of any length."""
    found = (re.fullmatch(r"tuple\[(float|int), \.\.\.\]", kind) for kind in kinds)
    return [match[1] for match in found if match]
