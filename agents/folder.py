"""Commands that go on in their folder: with the same settings, and with errors of one line."""

from __future__ import annotations

import json
import shlex
import subprocess
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

from spoofgym.bench.experiments.identity import versions
from spoofgym.core.files import remove_stale_parts, write_file
from spoofgym.core.settings import unlike

CONFIG = "config.json"


def used_versions() -> dict[str, str]:
    """What a training depends on."""
    return versions() | {name: version(name) for name in ("torch", "stable-baselines3", "onnx")}


def open_folder(folder: Path, arguments: dict[str, Any]) -> None:
    """Write the settings of a training, or look whether the one in the folder has the same.
    `arguments`: settings that decide the result, JSON-able."""
    path, here = folder / CONFIG, {"arguments": arguments, "versions": used_versions()}
    remove_stale_parts(folder)
    if not path.is_file():
        if folder.is_dir() and any(folder.iterdir()):
            raise ValueError(f"{folder} is not empty and holds no {CONFIG}; choose another --out")
        write_file(path, (json.dumps(here, indent=1) + "\n").encode())
        return
    try:
        there = json.loads(path.read_text(encoding="utf-8"))
        found = unlike({key: there[key] for key in here}, here)
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is damaged ({error!r}); choose another --out") from error
    if found:
        lines = "; ".join(line.replace(" on the card", " there") for line in found)
        raise ValueError(
            f"{folder} holds a run with other settings, which can't be gone on with: {lines}"
            "; choose another --out"
        )


def json_object(name: str, text: str) -> dict[str, Any]:
    """JSON object of a setting; a ValueError names the setting and what it is."""
    try:
        found = json.loads(text)
    except ValueError as error:
        raise ValueError(f"`{name}` is not JSON: {error}; got {text!r}") from error
    if not isinstance(found, dict):
        raise ValueError(f"`{name}` must be a JSON object, got {text!r}")
    return found


@contextmanager
def error_lines() -> Iterator[None]:
    """End the program with one line where the user has made a mistake, or pressed Ctrl-C."""
    try:
        yield
    except (ValueError, TypeError, OSError, subprocess.SubprocessError) as error:
        raise SystemExit(f"error: {' '.join(str(error).split())}") from error
    except KeyboardInterrupt:
        raise SystemExit("interrupted; the same command goes on") from None


def command_of(module: str, args: Any, free: Container[str], last: Sequence[str] = ()) -> str:
    """Command line of a training again: what is not a default and not `free`, and `last`."""
    words = ["--out", args.out.name]
    for item in fields(args):
        value = getattr(args, item.name)
        if item.name not in free and value != item.default:
            words += [f"--{item.name.replace('_', '-')}", str(value)]
    return shlex.join(["python", "-m", module, *words, *last])
