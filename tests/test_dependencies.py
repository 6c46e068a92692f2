"""What is installed with spoofgym is pinned, and the extras hold what they are for."""

import ast
import importlib
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
PINS = {
    canonicalize_name(pin.name): pin.specifier
    for pin in (
        Requirement(line)
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if not line.startswith("#")
    )
}


def declared(name, extra):
    """Requirements of a distribution, or of one of its extras; none where it isn't installed."""
    if name == "spoofgym":  # as this checkout says, whatever is installed
        return PROJECT["dependencies"] if extra == "" else EXTRAS[extra]
    try:
        return metadata.requires(name) or []
    except metadata.PackageNotFoundError:
        return []


def installed_with(*extras):
    """Every requirement that pip meets here for spoofgym with some extras: by name, by whom."""
    found, seen = {}, set()
    todo = [("spoofgym", extra) for extra in ("", *extras)]
    while todo:
        owner, extra = todo.pop()
        if (owner, extra) in seen:
            continue
        seen.add((owner, extra))
        for requirement in map(Requirement, declared(owner, extra)):
            if requirement.marker and not requirement.marker.evaluate({"extra": extra}):
                continue
            name = canonicalize_name(requirement.name)
            if name != "spoofgym":
                found.setdefault(name, []).append((owner, requirement.specifier))
            todo += [(name, more) for more in ("", *requirement.extras)]
    return found


@pytest.mark.parametrize("extra", sorted({*EXTRAS} - {"ray", "ray-campaign"}))
def test_all_that_an_extra_installs_is_pinned_to_a_version_that_fits(extra):
    found = installed_with(extra)
    assert {*found} - {*PINS} == set()
    assert {"numpy", "llvmlite"} <= {*found}
    for name, wanted in found.items():
        (version,) = (pin.version for pin in PINS[name])
        for owner, specifier in wanted:
            assert specifier.contains(version, prereleases=True), (name, owner)


def test_the_laboratory_s_extra_holds_what_its_code_and_its_pages_use():
    imported = set()
    for folder in ("agents", "baselines", "train"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    imported |= {alias.name for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and not node.level:
                    imported.add(node.module)
    outside = {name.partition(".")[0] for name in imported} - sys.stdlib_module_names
    owners = metadata.packages_distributions()
    installed = installed_with("train")
    for module in sorted(outside - {"spoofgym", "agents", "baselines", "train"}):
        assert {canonicalize_name(owner) for owner in owners[module]} & {*installed}, module
    # `RecordEpochs` writes Parquet, Gymnasium's `RecordVideo` takes moviepy
    assert {"pyarrow", "moviepy", "torch", "sympy"} <= {*installed}
    assert "torch" not in installed_with()


@pytest.mark.parametrize(
    ("module", "package"),
    [
        ("spoofgym.export", "torch"),
        ("spoofgym.sb3", "stable_baselines3"),
        ("train.ppo_spoofer", "tyro"),
    ],
)
def test_a_module_without_its_packages_names_the_extra(module, package, monkeypatch):
    top = "train" if module.startswith("train") else module
    for name in [name for name in sys.modules if name == top or name.startswith(f"{top}.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"needs {package}: pip install 'spoofgym\[train\]'"):
        importlib.import_module(module)
