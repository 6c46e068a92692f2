"""The README's tables name everything that is registered, and nothing else."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from spoofgym.attacks import ATTACKS
from spoofgym.detectors import DETECTORS
from spoofgym.spoofers import SPOOFERS, shipped

README = (Path(__file__).resolve().parents[2] / "README.md").read_text()


def first_column(head: str) -> list[str]:
    table = README.split(f"| {head} |", 1)[1].split("\n\n", 1)[0]
    return re.findall(
        r"`([^`]+)`", "\n".join(re.findall(r"^\| ([^|]+) \|", table, flags=re.MULTILINE))
    )


@pytest.mark.parametrize(
    ("head", "names"),
    [
        ("detector | what it looks at", DETECTORS),
        ("spoofer | what it does", SPOOFERS),
        ("attack | what is counterfeited", ATTACKS),
        ("shipped spoofer | what it is", shipped()),
    ],
)
def test_a_table_names_everything(head, names):
    assert sorted(first_column(head)) == sorted(names)
