"""The pages on terms: their code runs, and their tables are those of the registry."""

from __future__ import annotations

import dataclasses
import importlib.util
import re
import sys
import types
from pathlib import Path

import gymnasium as gym
import pytest

from spoofgym.envs.terms import TERMS

from .pages import blocks_of

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = ("terms.md", "own_observation_term.md")


@pytest.mark.parametrize("page", PAGES)
def test_the_code_of_a_page_runs(page, tmp_path, monkeypatch):
    text, blocks = (DOCS / page).read_text(), blocks_of(page)
    assert blocks
    if "RecordEpochs" in text:
        pytest.importorskip("pyarrow")
    for kind in TERMS:  # a page may add to the registry
        kept = dict(TERMS[kind])
        monkeypatch.setitem(TERMS, kind, kept)
    monkeypatch.chdir(tmp_path)
    module = types.ModuleType("page")
    monkeypatch.setitem(sys.modules, "page", module)
    for number, (needs, block) in enumerate(blocks):
        if needs is not None and importlib.util.find_spec(needs) is None:
            continue
        exec(compile(block, f"{page} block {number}", "exec"), module.__dict__)


def row_of(kind, name, term):
    settings = [
        f"`{f.name}`" if f.default is dataclasses.MISSING else f"`{f.name}={f.default!r}`"
        for f in dataclasses.fields(term)
    ]
    known = [term.knowledge] if kind == "observation" else []
    text = " ".join(term.__doc__.split("\n\n")[0].split())
    return f"| {' | '.join([f'`{name}`', ', '.join(settings) or 'none', *known, text])} |"


@pytest.mark.parametrize("kind", TERMS)
def test_the_table_is_that_of_the_registry(kind):
    text = (DOCS / "terms.md").read_text()
    (table,) = re.findall(rf"<!-- {kind} -->\n(.*?)\n<!-- -->", text, flags=re.DOTALL)
    assert table.splitlines()[2:] == [row_of(kind, *each) for each in TERMS[kind].items()]


def test_the_keys_of_the_information_are_those_of_the_table():
    text = (DOCS / "terms.md").read_text()
    (table,) = re.findall(r"<!-- info -->\n(.*?)\n<!-- -->", text, flags=re.DOTALL)
    rows = [line.split("|")[1:4] for line in table.splitlines()[2:]]
    patterns = {
        key.strip(" `"): (re.sub("<.*?>", r"\\w+", key.strip(" `")), unit.strip(), when)
        for key, unit, when in rows
    }
    env = gym.make(
        "spoofgym/TightlyCoupled-v0",
        timeline={"warmup_s": 6, "live_s": 2, "attack_s": 5, "time_to_alert_s": 1},
        attack={"name": "false-position", "capture": {}},
        detector={"name": "ewma", "thresholds": "nominal"},
        end={"name": "at-displacement", "limit_m": 5.0},
        watch={"name": "cusum", "thresholds": "nominal"},
        twin=True,
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


def test_the_pages_are_listed():
    listed = (DOCS / "README.md").read_text()
    assert all(f"({page})" in listed for page in PAGES)
