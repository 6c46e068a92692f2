"""The table of versions on docs/promises.md, from pyproject.toml and the files of constraints.

python -m tools.versions  # writes the table
"""

from __future__ import annotations

import tomllib
from itertools import chain

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tools.pages import DOCS, ROOT, marks, put_between

PAGE, MARKS = DOCS / "promises.md", marks("versions")
PACKAGES = (
    "numpy",
    "numba",
    "gymnasium",
    "pettingzoo",
    "onnxruntime",
    "stable-baselines3",
    "torch",
    "ray",
    "minari",
)
"""What users come with."""


def read_versions(file: str) -> dict[str, str]:
    """Versions that a file of constraints pins, by package."""
    lines = (ROOT / file).read_text().splitlines()
    pairs = [line.split("==") for line in lines if "==" in line and not line.startswith("#")]
    return {canonicalize_name(name.strip()): version.strip() for name, version in pairs}


def read_bounds() -> dict[str, str]:
    """What pyproject.toml allows, by package; the first where several extras name it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    bounds: dict[str, str] = {}
    for line in chain(project["dependencies"], *project["optional-dependencies"].values()):
        required = Requirement(line)
        bounds.setdefault(canonicalize_name(required.name), str(required.specifier))
    return bounds


def make_table() -> str:
    bounds, tested, ray = (
        read_bounds(),
        *map(read_versions, ("constraints.txt", "constraints-ray.txt")),
    )
    rows = [
        f"| {name} | {bounds.get(name, '')} | {tested.get(name, '')} | {ray.get(name, '')} |"
        for name in PACKAGES
    ]
    head = "| package | allowed | `make test` | `make test-ray` |\n|---|---|---|---|\n"
    return f"\n{head}" + "\n".join(rows) + "\n\n"


if __name__ == "__main__":
    put_between(PAGE, *MARKS, make_table())
