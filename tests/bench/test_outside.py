"""Results of classes that are not ours follow their sources."""

import importlib
import sys
from dataclasses import dataclass

import pytest

from spoofgym.bench.experiments import Store
from spoofgym.core.settings import outside_sources
from spoofgym.detectors import Ewma
from spoofgym.policies.contract import DetectorPolicy

from .support import small_suite, write_policy

MODULES = ("mine_a34", "helper_a34")
MINE = """
from dataclasses import dataclass
import numpy as np
from helper_a34 import SCALE
from spoofgym.attacks import make_attack
from spoofgym.detectors import Ewma
from spoofgym.policies.contract import DetectorPolicy
from spoofgym.spoofers import Ramp

class Mine(Ewma):
    pass

class Pusher(Ramp):
    pass

class Grab(type(make_attack("false-position"))):
    pass

@dataclass
class Calm(DetectorPolicy):
    def decide(self, observation):
        return np.zeros((len(observation), 1))
"""


def write(folder, mine=MINE, helper="SCALE = 1.0\n"):
    for name, text in zip(MODULES, (mine, helper), strict=True):
        (folder / f"{name}.py").write_text(text)
        sys.modules.pop(name, None)
    importlib.invalidate_caches()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    write(tmp_path)
    yield tmp_path
    for name in MODULES:
        sys.modules.pop(name, None)


def suites():
    module = importlib.import_module("mine_a34")
    return {
        "detector": small_suite(detectors=("ewma", "mine_a34:Mine")),
        "detector, an object": small_suite(detectors=(module.Mine(),)),
        "spoofer": small_suite(spoofers=({"name": "mine_a34:Pusher", "rate_mps": "tuned"},)),
        "attack": small_suite(attack=module.Grab()),
    }


def test_an_edited_class_is_another_campaign_and_an_edited_policy_not_calibrated(folder):
    assert small_suite().config["outside"] == {}
    for comment in ("", "\n# a comment\n"):
        write(folder, MINE + comment)
        for name, suite in suites().items():
            Store(folder / name).open("campaign", suite.config)
    for module, edit in (("mine", {"mine": f"{MINE}\nX = 1\n"}), ("helper", {"helper": "SCALE=2"})):
        write(folder, **edit)
        for name, suite in suites().items():
            with pytest.raises(ValueError, match=rf"results \(config\.outside\.{module}_a34: "):
                Store(folder / name).open("campaign", suite.config)
    digests = []
    for text in (MINE, MINE, MINE.replace("np.zeros", "np.ones")):
        write(folder, text)
        digests.append(importlib.import_module("mine_a34").Calm().digest())
    assert digests[0] == digests[1] != digests[2]
    typed = dataclass(type("Typed", (DetectorPolicy,), {"decide": print, "__module__": "__main__"}))
    assert None in outside_sources(typed()).values()
    assert typed().digest() is None


def test_a_policy_and_its_card_count(tmp_path):
    path = tmp_path / "push.onnx"
    write_policy(path, small_suite(), "blind", (0.0, 0.1))
    suite = small_suite(spoofers=(str(path),))
    before, (_, entry) = suite.config["outside"], suite.spoofer_players
    assert (entry.label, len(entry.spec["sha256"])) == ("push", 64)
    assert set(before) == {"push.onnx", "push.json"}
    card = path.with_suffix(".json")
    card.write_text(card.read_text().replace("ewma, by hand", "ewma, by foot"))
    after = small_suite(spoofers=(str(path),)).config["outside"]
    assert [name for name in after if after[name] != before[name]] == [card.name]


def test_a_class_without_a_source_is_never_taken_up_again(tmp_path, monkeypatch):
    typed = type("Typed", (Ewma,), {"__module__": "__main__"})
    monkeypatch.setattr(sys.modules["__main__"], "Typed", typed, raising=False)
    suite, again = (small_suite(detectors=(typed(),)) for _ in range(2))
    with pytest.warns(UserWarning, match="source of __main__:Typed can't be read: its results are"):
        Store(tmp_path).open("campaign", suite.config)
    assert "never taken up again" in suite.config["notes"][-1]
    Store(tmp_path).open("campaign", suite.config)
    with (
        pytest.warns(UserWarning, match="can't be read"),
        pytest.raises(ValueError, match=r"other results \(config\.outside\.__main__:Typed: "),
    ):
        Store(tmp_path).open("campaign", again.config)
