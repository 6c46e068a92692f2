"""What two examples of the README print, kept in docs/readme.json with what printed it.

python -m tools.readme_figures wrapper demo

A test compares code and commands with the README's, and its figures with what is kept.  Training
and audit are those of the tutorials, which hold what they printed.
"""

from __future__ import annotations

import argparse
import json
import platform
import re
import shlex
import sys
import tempfile
from pathlib import Path
from typing import Any

from agents.folder import write_json
from spoofgym.core.registry import check_choice
from tools import costs
from tools.pages import DOCS, ROOT

DATA_FILE = DOCS / "readme.json"


def read_parts(readme: str) -> dict[str, dict[str, str]]:
    """Code, or command, of each example."""
    blocks = re.findall(r"```python\n(.*?)```", readme, flags=re.S)
    (code,) = (block for block in blocks if "AlarmRecorder" in block)
    (command,) = re.findall(r"^spoofgym (demo)\b", readme, flags=re.M)
    return {"wrapper": {"code": code, "command": ""}, "demo": {"code": "", "command": command}}


def play(part: dict[str, str]) -> dict[str, Any]:
    """Run an example in a folder of its own, with nothing calibrated before."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder, "example.py")
        program.write_text(part["code"])
        command = ["-m", "spoofgym", *shlex.split(part["command"])]
        took, printed = costs.play(command if part["command"] else [program.name], folder)
    machine = f"{costs.read_processor()}, {platform.system()}"
    return {**part, "printed": printed, **took, "machine": machine}


def main(arguments: list[str]) -> None:
    parts = read_parts((ROOT / "README.md").read_text())
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("examples", nargs="+", help=f"what is played: {', '.join(parts)}")
    names = parser.parse_args(arguments).examples
    for name in names:
        check_choice("example", name, parts)
    kept = json.loads(DATA_FILE.read_text()) if DATA_FILE.exists() else {}
    for name in names:
        kept[name] = play(parts[name])
        write_json(DATA_FILE, kept)


if __name__ == "__main__":
    main(sys.argv[1:])
