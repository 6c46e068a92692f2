"""The tables of the page on terms are those of the registry."""

import dataclasses
import re

import gymnasium as gym
import pytest

from spoofgym.envs.terms import TERMS

from .pages import text_of

PAGE = text_of("terms.md")


def table_of(kind):
    (table,) = re.findall(rf"<!-- {kind} -->\n(.*?)\n<!-- -->", PAGE, flags=re.DOTALL)
    return [line for line in table.splitlines() if line.startswith("| `")]


@pytest.mark.parametrize("kind", TERMS)
def test_the_table_is_that_of_the_registry(kind):
    rows, setup = [], gym.make("spoofgym/Zhong2025-v0").unwrapped.core.setup
    for name, term in TERMS[kind].items():
        settings = [
            f"`{f.name}`" if f.default is dataclasses.MISSING else f"`{f.name}={f.default!r}`"
            for f in dataclasses.fields(term)
        ]
        known = []
        if kind == "observation":
            size = "-" if name == "own-offsets" else len(term().names(setup))
            known = [term.knowledge, str(size)]
        text = " ".join(term.__doc__.split("\n\n")[0].split())
        cells = [f"`{name}`", ", ".join(settings) or "none", *known, text]
        rows.append(f"| {' | '.join(cells)} |")
    assert table_of(kind) == rows


def test_the_keys_of_the_information_are_those_of_the_table():
    rows = [line.split("|")[1:4] for line in table_of("info")]
    patterns = {
        key.strip(" `"): (re.sub("<.*?>", r"\\w+", key.strip(" `")), unit.strip(), when)
        for key, unit, when in rows
    }
    env = gym.make(
        "spoofgym/Zhong2025-v0",
        timeline={"warmup_s": 6, "live_s": 2, "attack_s": 5, "time_to_alert_s": 1},
        attack={"name": "false-position", "capture": {}},
        detector={"name": "ewma", "thresholds": "nominal"},
        end={"name": "at-displacement", "limit_m": 5.0},
        watch={"name": "cusum", "thresholds": "nominal"},
        twin=True,
        epoch=True,
    )
    _, begun = env.reset(seed=0)
    info = env.step([0.0])[4]
    for told, word in ((begun, "reset"), (info, "step")):
        listed = {key: row for key, row in patterns.items() if word in row[2]}
        found = {
            name: next((key for key, row in listed.items() if re.fullmatch(row[0], name)), None)
            for name in told
        }
        assert set(found.values()) == listed.keys()
        for name, key in found.items():
            assert isinstance(told[name], bool) == (listed[key][1] == "bool"), name
