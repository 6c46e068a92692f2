"""What the pages let their reader run, in the order of a page, and what of it is made smaller."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from .pages import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMANDS, CODE = ("console", "bash", "sh"), "python"
SHOWN = {
    "text": "a drawing",
    "json": "a result",
    "cpp": "tests/docs/test_logs.py compiles it",
    "matlab": "tests/docs/test_logs.py plays it where Octave is",
    "toml": "a file that the reader saves",
    "{eval-rst}": "`make docs` builds them",
}
"""Languages of blocks that are nothing to run, and what they are."""
NEEDS = {
    "numba_cuda": "a machine with a GPU runs them",
    "ray": "`make test-ray` runs them, in an environment of its own",
    "minari": "as that",
}
"""What blocks of Python need that the environment of the tests can't have, and who runs them."""
CODE_FIRST = {"docs/catalogue.md": "its commands play the file that its code writes"}
BESIDE = {
    "docs/train_your_own.md": [
        "spoofgym run --scenario trolley --tuning matched --detector snapshot-chi2 "
        "--spoofer runs/my-first/my-first.onnx --out runs/my-first/elsewhere.png"
    ]
}
"""Commands that a page gives but for the words that do not change."""
LEARNING = "--steps 200 --num-envs 4 --batch-size 400 --stages 1 --fit-runs 80 --runs 20 --rivals"
CAMPAIGN = "--budget quick --runs 8 --training-runs 80 --selection-runs 12"
ELSEWHERE = '--out "$(mktemp -d)"'
"""Folder of a campaign that a sentence names as the origin of its figures."""
AUDIT = "--budget quick --runs 8 --selection-runs 4 --family ramps --family open-loop --seed 0"
SMALLER: dict[str, tuple[str | None, str]] = {
    r"pip install ": (None, "the tests' environment has them; test_readme compares the extras"),
    r"spoofgym log import FLIGHT\.": (None, "tests/receiver/test_autopilots.py writes such files"),
    r"spoofgym dataset .* --format minari": (None, "tests/test_cli_dataset.py plays one like it"),
    r"make test$": (None, "the other list, which is run beside this one"),
    r"python -m tools\.frozen ": (None, "needs a commit; tests/tools has tests of it"),
    r"python -m tools\.transfer ": (
        None,
        "asks for two calibrations first, and takes 14 minutes; tests/tools has tests of it",
    ),
    r"python -m tools\.learned_page ": (
        None,
        "its tables are those of hours of training; tests/tools has tests of it",
    ),
    r"python -m tools\.game_page ": (None, "as that"),
    r"python -m train\.double_oracle ": (
        "--iterations 1 --runs 24 --selection-runs 16 --sift-runs 8 --values 2 --search-runs 0 "
        "--generations 1 --ppo-steps 0",
        "36 minutes",
    ),
    r"python -m tools\.learn_all .*--only window-data": (
        "--list",
        "an hour; tests/tools plays steps",
    ),
    r"python -m tools\.fuzz ": ("--cases 40", "an hour; tests/tools has tests of it"),
    r"python -m benchmarks\.perf --(json|markdown)$": ("--quick", "the same again"),
    r"python -m tools\.kills ": ("--kills 2", "an hour; tests/tools has tests of it"),
    r"python -m train\.detector --data runs/data": ("--passes 2", "minutes"),
    r"python -m train\.ppo_spoofer ": (f"{LEARNING} --seeds 0", "12 to 35 minutes each"),
    r"python -m train\.plain_ppo ": (
        "--steps 400 --scores 1 --fit-runs 80 --runs 20 --seeds 0",
        "a quarter of an hour a seed",
    ),
    r"python -m train\.ppo_detector ": ("--steps 400 --runs 19 --seeds 1", "minutes a seed"),
    r"python -m train\.ppo_cuda ": (None, "needs a GPU; tests/train plays it on the processor"),
    r"spoofgym \w+ --device cuda": (None, "needs a GPU; tests/bench plays them by a simulator"),
    r"python -m train\.(offsets|replay)_ppo ": ("--list", "an hour; tests/train plays them"),
    r"python -m train\.spoofers ": (None, "180 trainings; tests/train plays it small"),
    r"python -m tools\.refits ": (None, "hours; tests/tools plays it small"),
    r"python -m tools\.task_cards ": (None, "hours; tests/tools plays it small"),
    r"python -m tools\.detector_cards ": (None, "over an hour; tests/tools plays it small"),
    r"python -m tools\.against_reference ": (
        None,
        "a quarter of an hour; tests/tools plays its parts",
    ),
    r"spoofgym bench --budget quick --detector cumulative-": (
        ELSEWHERE,
        "rows of a table: the audit before it has taken the default folder",
    ),
    r"spoofgym bench --detector all ": (
        f"--detector ewma {CAMPAIGN} {ELSEWHERE}",
        "1000 runs against every detector",
    ),
    r"spoofgym bench --detector guard\.onnx ": (CAMPAIGN, "most of an hour"),
    r"spoofgym bench --(budget \w+ --)?detector solution-": (None, "tools.costs measures them"),
    r"spoofgym bench --track ": (f"--detector ewma {CAMPAIGN}", "a calibration for each detector"),
    r"spoofgym calibrate ": ("--runs 2000", "20,000 runs of its world"),
    r"spoofgym bench --(seed|scenario zhong2025 --out) ": (
        f"--detector ewma {CAMPAIGN}",
        "every detector, half an hour",
    ),
    r"spoofgym run .* --spoofer ppo\.onnx": (None, "a policy of one's own in this space"),
    r"spoofgym bench --task S1 --spoofer my": (
        CAMPAIGN,
        "half an hour",
    ),
    r"spoofgym dataset runs/(data|mine) ": (
        "--train 64 --validation 128 --test 128",
        "1280 runs, ten minutes",
    ),
    r"spoofgym bench --detector ewma ": (CAMPAIGN, "minutes"),
    r"spoofgym bench --detector my_detector": (CAMPAIGN, "ten minutes"),
    r"make bench$": (f'ARGS="{CAMPAIGN}"', "minutes; a fresh checkout runs it"),
    r"python -m baselines\.papers all$": (None, "the five papers, which have a page each"),
    r"python -m baselines\.papers\.page$": ("ke2022", "the one that its page runs in full before"),
    r"spoofgym audit my_detector": (
        None,
        "a calibration; tests/bench/test_audit.py has one like it",
    ),
    r"spoofgym audit .* --log ": ("--family ramps", "a minute"),
    r"cd my-attack && spoofgym audit --spoofer ": (
        "--budget quick --runs 8 --seed 0",
        "twelve detectors",
    ),
    r"spoofgym audit --spoofer ": ("--budget quick --runs 8 --seed 0", "twelve detectors"),
    r"cd my-entry && spoofgym audit ": (AUDIT, "an hour"),
    r"spoofgym audit ": (AUDIT, "a minute to ten, and a calibration"),
}
"""How commands begin that would take more than some ten minutes or can't run here; with what
options they run instead, None where they do not; and why."""
SMALLER_CODE = {
    "calibrate_detectors(setup, [": "calibrate_detectors(setup, runs=2000, detectors=[",
    "TURNS, STEPS, RUNS = 4, 20_000, 200": "TURNS, STEPS, RUNS = 1, 1_024, 19",
    "learn(100_000": "learn(9_600",
    "learn(150_000": "learn(9_600",
    "learn(300_000": "learn(9_600",
    "learn(1_000_000": "learn(9_600",
    "= 16, 128, 60, 4, 0.2": "= 16, 128, 4, 4, 0.2",
}
"""What stands in place of a part of a block of Python that would take as long."""
SPAN = re.compile(r"(?<!`)`((?:spoofgym|python -m|make) [^`\n]* ?--[^`\n]*)`(?!`)")
"""A command within a sentence, with options: one without is the name of a program."""
PLACEHOLDER = re.compile(r"\b(NAME|COMMIT|KEY|FILE)\b")
PART = re.compile(
    r"(?:<!-- needs (?P<needs>\w+) -->\n)?^ *```(?P<language>[^`\s]+)\n(?P<text>.*?)^ *```$"
    r"|Saved as `(?P<saved>\w+\.(?:py|toml))`"
    rf"|{SPAN.pattern}",
    flags=re.DOTALL | re.MULTILINE,
)


class Step(NamedTuple):
    """A command or a block of code of a page, or a file that its reader saves."""

    kind: str
    text: str
    needs: str = ""


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def languages_of(page: Path) -> set[str]:
    return {found["language"] for found in PART.finditer(page.read_text()) if found["language"]}


def steps_of(page: Path) -> list[Step]:
    """Everything that a page has one run, as it stands there."""
    found, blocks = list[Step](), dict[str, str]()
    for part in PART.finditer(page.read_text()):
        if part["language"]:
            blocks[part["language"]] = part["text"]
        if part["saved"]:
            kind = part["saved"].split(".")[1].replace("py", CODE)
            found.append(Step(part["saved"], blocks[kind]))
        elif part["language"] == CODE:
            found.append(Step(CODE, part["text"], part["needs"] or ""))
        elif part["language"] in COMMANDS:
            found += [Step("command", line) for line in lines_of(part["text"])]
        elif not part["language"] and not PLACEHOLDER.search(part[0]):
            found.append(Step("command", part[0].strip("`")))
    found += [Step("command", line) for line in BESIDE.get(name_of(page), ())]
    first = name_of(page) in CODE_FIRST
    return sorted(found, key=lambda step: step.kind == "command") if first else found


def lines_of(block: str) -> list[str]:
    lines = re.sub(r"\\\n\s*", "", block).splitlines()
    return [bare for line in lines if (bare := re.sub(r"(^|\s+)# .*", "", line).strip())]


def form_of(command: str) -> str | None:
    """What is run of a command, None for nothing."""
    plain = command.removeprefix(".venv/bin/")
    for begin, (options, _) in SMALLER.items():
        if re.match(begin, plain):
            return None if options is None else with_options(command, options)
    return command


def code_of(block: str) -> str:
    for part, smaller in SMALLER_CODE.items():
        block = block.replace(part, smaller)
    return block


def with_options(command: str, options: str) -> str:
    """A command with these options in place of those that it has."""
    for flag in re.findall(r"--[a-z-]+", options):
        command = re.sub(rf" {flag}(?: (?!--)\S+)*", "", command)
    return f"{command} {options}"
