"""Packages that come with an extra of the distribution."""

from __future__ import annotations


def name_extra(what: str, error: ImportError, extra: str = "train") -> ImportError:
    """The error of a package that can't be imported, with the extra that installs it."""
    return ImportError(
        f"{what} needs {error.name}: pip install 'spoofgym[{extra}]', or '.[{extra}]' in a "
        f"checkout ({error})"
    )
