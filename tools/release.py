"""Builds sdist and wheel, tries both in clean environments, writes a bill of materials of what is
installed there, and prints what is left to do by hand.

    make release

Needs a Python and a package index, nothing else.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
import tomllib
import venv
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
PINS = ROOT / "constraints.txt"
EXTRAS = "report,flights"
TOOLS = ("build", "cyclonedx-bom", "sp-repo-review[cli]")
TRIED = ("spoofgym demo",)
"""Commands of the README that end in a minute or two; the others are listed, `spoofgym warmup`,
which compiles much more than these need, among them."""
CHECK = "from my_detector import AverageRate as A; from spoofgym.testing import check_detector as c"
PLACEHOLDER = "example.org"


def list_commands(readme: str) -> list[str]:
    """All that a README lets a reader type, once each, in its order."""
    blocks = re.findall(r"```console\n(.*?)```", readme, flags=re.DOTALL)
    typed = [line.partition(" #")[0].strip() for block in blocks for line in block.splitlines()]
    inline = re.findall(r"`(spoofgym [^`]+)`", readme)
    return list(dict.fromkeys(line for line in (*inline, *typed) if line))


def split_commands(commands: list[str]) -> tuple[list[str], list[str]]:
    """Those that are tried, and those that are not."""
    tried = [line for start in TRIED for line in commands if line.startswith(start)]
    return tried, [line for line in commands if line not in tried]


def find_detector(readme: str) -> str:
    """The detector that the README lets its reader save as `my_detector.py`."""
    return re.findall(r"```python\n(.*?)```", readme, flags=re.DOTALL)[-1]


def list_left_over(project: dict[str, object], changelog: str, version: str) -> Iterator[str]:
    """What no program does."""
    if PLACEHOLDER in str(project["urls"]):
        yield f"put addresses for {PLACEHOLDER} into [project.urls] of pyproject.toml"
    if "## Unreleased" in changelog:
        yield f"give the changes of CHANGELOG.md the heading {version} and a date"
    yield "run what takes long: make test test-nightly test-cpus test-pythons test-ray soak"
    yield "pin the actions of .github/workflows to commits"
    yield "name release.yml and its environment `release` a trusted publisher at the package index"
    yield f"git tag -s v{version}, and push it: the workflow builds again, tries and publishes"


def run(*words: object, cwd: Path = ROOT) -> None:
    """A command that has to end well; it finds nothing of this checkout by accident."""
    print("$", shlex.join(map(str, words)), flush=True)
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run([*map(str, words)], cwd=cwd, env=clean, check=True)


def make_environment(folder: Path, *wanted: str) -> Path:
    """A new environment with the pinned versions of what is wanted; returns its programs."""
    venv.create(folder, with_pip=True)
    programs = folder / "bin"
    run(programs / "python", "-m", "pip", "install", "-q", "--prefer-binary", "-c", PINS, *wanted)
    return programs


def build(programs: Path) -> list[Path]:
    run(programs / "repo-review", ROOT)
    for old in DIST.glob("spoofgym-*"):
        old.unlink()
    run(programs / "python", "-m", "build", "--outdir", DIST)
    return sorted(DIST.glob("spoofgym-*"))


def try_out(distribution: Path, folder: Path, readme: str) -> Path:
    """Install a file as a user does, and do what the README says; returns the programs."""
    programs = make_environment(folder / "env", f"{distribution}[{EXTRAS}]")
    work = folder / "work"
    work.mkdir()
    for line in split_commands(list_commands(readme))[0]:
        name, *words = shlex.split(line)
        run(programs / name, *words, cwd=work)
    (work / "my_detector.py").write_text(find_detector(readme))
    run(programs / "python", "-c", f"{CHECK}; c(A())", cwd=work)
    return programs


def list_unpinned(bom: str, pins: str) -> list[str]:
    """What a bill of materials names in no version or another than the pinned one."""
    plain = {re.sub(r"[-_.]+", "-", line).lower() for line in pins.splitlines()}
    named = [f"{each['name']}=={each.get('version')}" for each in json.loads(bom)["components"]]
    return [each for each in named if re.sub(r"[-_.]+", "-", each).lower() not in plain]


def write_bom(tools: Path, programs: Path, version: str) -> Path:
    """All that is installed with a distribution as CycloneDX JSON, checked by its schema.

    pip and setuptools, which came with the environment, are removed from it.
    """
    run(programs / "python", "-m", "pip", "uninstall", "-q", "-y", "pip", "setuptools")
    project = programs / "pyproject.toml"
    text = (ROOT / "pyproject.toml").read_text()
    project.write_text(text.replace('dynamic = ["version"]', f'version = "{version}"'))
    bom = DIST / f"spoofgym-{version}.cdx.json"
    words = ("environment", "--mc-type=library", "--output-reproducible", "--validate")
    run(tools / "cyclonedx-py", *words, "--pyproject", project, "-o", bom, programs / "python")
    if unpinned := list_unpinned(bom.read_text(), PINS.read_text()):
        sys.exit(f"no release: constraints.txt does not pin {', '.join(unpinned)}")
    return bom


def main() -> None:
    readme = (ROOT / "README.md").read_text()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    with tempfile.TemporaryDirectory(prefix="release-") as temporary:
        folder = Path(temporary)
        tools = make_environment(folder / "tools", *TOOLS)
        made = build(tools)
        version = made[0].name.split("-")[1].removesuffix(".tar.gz")
        for each in made:
            (folder / each.suffix[1:]).mkdir()
            programs = try_out(each, folder / each.suffix[1:], readme)
        made.append(write_bom(tools, programs, version))
    print(f"\nBuilt and tried with Python {sys.version.split()[0]}:")
    for each in made:
        print(f"  {each.name}  sha256 {hashlib.sha256(each.read_bytes()).hexdigest()}")
    print("\nOf the README, not run here:")
    for line in split_commands(list_commands(readme))[1]:
        print(f"  {line}")
    print(
        "  all other blocks of Python (tests/docs/test_readme.py plays them with smaller numbers)"
    )
    print("\nLeft to do by hand:")
    for line in list_left_over(project, (ROOT / "CHANGELOG.md").read_text(), version):
        print(f"  {line}")


if __name__ == "__main__":
    try:
        main()
    except subprocess.CalledProcessError as error:
        sys.exit(f"no release: {shlex.join(error.cmd)} ended with {error.returncode}")
