"""Every declared bound of every setting: what is at, below and above it, and what is no number.

Bounds and annotations come from the classes, so that a new setting is tried without a word here.
"""

import dataclasses
import inspect
import json
import math

import numpy as np
import pytest

from spoofgym.attacks import ATTACKS
from spoofgym.core.declared import list_declarations, parse_list_kinds, split_union
from spoofgym.core.settings import describe, get_kind
from spoofgym.detectors import DETECTORS
from spoofgym.detectors.observation import DETECTOR_TERMS
from spoofgym.envs import TERMS
from spoofgym.spoofers import SPOOFERS

from . import sources
from .examples import EXAMPLES

RECORDS = sorted(
    {
        kind
        for module in sources.modules()
        for kind in vars(module).values()
        if inspect.isclass(kind) and dataclasses.is_dataclass(kind) and list_declarations(kind)
        if kind.__module__ == module.__name__ and not inspect.isabstract(kind)
    },
    key=lambda kind: f"{kind.__module__}.{kind.__qualname__}",
)
REGISTERED = {
    f"{name}-{kind.__name__}": kind
    for name, kinds in {
        "attack": ATTACKS,
        "detector": DETECTORS,
        "spoofer": SPOOFERS,
        "detector-term": DETECTOR_TERMS,
        **TERMS,
    }.items()
    for kind in kinds.values()
}
every_record = pytest.mark.parametrize("kind", RECORDS, ids=lambda kind: kind.__name__)


def bad_numbers(declared, whole):
    """Numbers that a setting refuses: at a bound that is excluded, and beyond each."""
    bounds, step = declared, 1 if whole else None
    yield from (b for b in (bounds.above, bounds.below) if b is not None)
    if bounds.least is not None:
        yield bounds.least - (step or max(abs(bounds.least), 1.0) * 1e-9)
    if bounds.most is not None:
        yield bounds.most + (step or max(abs(bounds.most), 1.0) * 1e-9)
    if bounds.above is not None:
        yield bounds.above - 1
    if bounds.below is not None:
        yield bounds.below + 1
    yield math.nan
    yield True
    if not bounds.infinite:
        yield from (math.inf, -math.inf)
    if whole:
        yield (bounds.least or bounds.above or 0) + 0.5


def bad_values(declared, annotation):
    kinds = set(split_union(annotation))
    if "bool" in kinds:
        return ["yes", 2.0]
    found = []
    if {"int", "float"} & kinds:
        found += bad_numbers(declared, whole="float" not in kinds)
    for item in parse_list_kinds(kinds):
        found += [[each] for each in bad_numbers(declared, whole=item == "int")]
        found += ([] if declared.empty else [[]]) + ([[2, 2]] if declared.increasing else [])
    if declared.one_of:
        found += ["no such word"]
    return found


def example_of(kind):
    """A record of a class: by its defaults, or as in `EXAMPLES`."""
    if kind in EXAMPLES:
        return EXAMPLES[kind]()
    needed = [
        each.name
        for each in dataclasses.fields(kind)
        if each.default is each.default_factory is dataclasses.MISSING and each.init
    ]
    assert not needed, f"tests/conformance/examples.py needs a {kind.__name__} with {needed}"
    return kind()


@every_record
def test_what_is_not_valid_is_refused_by_name_and_value(kind):
    example = example_of(kind)
    for name, (declared, annotation) in list_declarations(kind).items():
        for bad in bad_values(declared, annotation):
            with pytest.raises(ValueError, match=f"^`{name}` must be ") as raised:
                dataclasses.replace(example, **{name: bad})
            said = str(raised.value)
            assert said.startswith(f"`{name}` must be {declared.valid(annotation)}, got {bad!r}")


@every_record
def test_bounds_that_are_included_and_defaults_are_valid_and_documented(kind):
    text = inspect.getdoc(kind)
    for name, (declared, annotation) in list_declarations(kind).items():
        kinds = set(split_union(annotation))
        numbers = [each for each in (declared.least, declared.most) if each is not None]
        fine = [*numbers, *map(np.float64, numbers)] if {"int", "float"} & kinds else []
        fine += [*declared.one_of, *([None] if "None" in kinds else [])]
        default = kind.__dataclass_fields__[name].default
        for value in fine if default is dataclasses.MISSING else [*fine, default]:
            declared.check(name, value, annotation)
        assert f"\n{name} : " in text
        assert declared.help[0].isupper(), name
        assert declared.help.endswith("."), name


@pytest.mark.parametrize("kind", REGISTERED.values(), ids=REGISTERED)
def test_settings_of_what_is_registered_are_written_into_results(kind):
    described = json.loads(json.dumps(describe(example_of(kind))))
    assert described["kind"] == get_kind(kind) == kind.__name__
