"""Docstrings of public classes agree with the fields and arguments that the classes have.

numpydoc's own validation takes no dataclass field for a parameter, hence these tests.
"""

from __future__ import annotations

import dataclasses
import inspect

import pytest
from numpydoc.docscrape import ClassDoc, FunctionDoc

from . import sources


def documented(doc, *sections):
    return [
        name.strip().lstrip("*")
        for section in sections
        for parameter in doc[section]
        for name in parameter.name.split(",")
    ]


def fields_of(kind):
    """Fields of a dataclass or a named tuple, else None."""
    if dataclasses.is_dataclass(kind):
        return [field.name for field in dataclasses.fields(kind) if field.init]
    if issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return list(kind._fields)
    return None


@pytest.mark.parametrize("kind", sources.public_classes())
def test_every_field_is_documented(kind):
    fields = fields_of(kind)
    if fields is None:
        return
    doc = ClassDoc(kind)
    told = documented(doc, "Parameters", "Attributes")
    assert [name for name in fields if name not in told] == []
    if dataclasses.is_dataclass(kind):
        assert [name for name in documented(doc, "Parameters") if name not in fields] == []


@pytest.mark.parametrize("kind", sources.public_classes())
def test_every_argument_is_documented(kind):
    protocol = getattr(kind, "_is_protocol", False)
    if protocol or fields_of(kind) is not None or "__init__" not in vars(kind):
        return
    arguments = [name for name in inspect.signature(kind.__init__).parameters if name != "self"]
    told = documented(ClassDoc(kind), "Parameters")
    if kind.__init__.__doc__:
        told += documented(FunctionDoc(kind.__init__), "Parameters")
    if issubclass(kind, dict) and not told:  # a container with a default of its own
        return
    assert sorted(told) == sorted(arguments)
