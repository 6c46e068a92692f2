"""Which terms compiled code may write in their place."""

from __future__ import annotations


def told_beside_call(term: object, name: str) -> bool:
    """Whether a term says by an attribute what its own `__call__` does.

    A subclass with another `__call__` inherits the attribute, which is not true of it any more.
    """
    return hasattr(term, name) and _owner(term, name) is _owner(term, "__call__")


def _owner(term: object, name: str) -> type | None:
    """Class that defines what a term has."""
    return next((cls for cls in type(term).__mro__ if name in vars(cls)), None)
