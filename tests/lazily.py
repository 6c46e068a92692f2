"""What a file of tests plays with, built where a test reads it, not in every process."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any


class Lazily:
    """Has the attributes of what a function returns, which is called for the first of them."""

    def __init__(self, build: Callable[..., Any], *given: Any) -> None:
        self._build = cache(partial(build, *given))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # as pytest reads of all that stands in a file
            raise AttributeError(name)
        return getattr(self._build(), name)
