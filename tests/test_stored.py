"""What is stored and shipped is still found: calibrations, cards, networks, the words for classes.

`tests/golden` compares the tasks.
"""

import dataclasses
import hashlib
import importlib
import inspect
import pkgutil
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import gymnasium as gym
import pytest

import spoofgym
import tools.calibrations
from spoofgym.attacks import PerChannel
from spoofgym.calibration.holdouts import check
from spoofgym.calibration.thresholds import inner_detectors
from spoofgym.core.settings import describe, get_kind
from spoofgym.detectors import Calibration, Detector
from spoofgym.detectors.calibrated import describe_identity
from spoofgym.detectors.calibration_file import SHIPPED_FOLDER, load_stored
from spoofgym.envs import attach
from spoofgym.policies import DetectorCard, SpooferCard, list_shipped, load_card
from spoofgym.simulation.setup import Timeline
from spoofgym.tasks import get_task
from tools.calibrations import WORLDS, list_detectors

SHIPPED_FILES = 218
REPLAYED = 1
"""Witnesses of each calibration that are played again here; `make test-nightly` plays all."""
SLOW = {
    "T4": "8bcd426310fa6fe1",
    "S1": "c45ccc329497f0f7",
    "S2": "d9245bc1aa11b4c1",
    "S3": "1126bcc4bc83ec40",
}
"""Folders of worlds that take a minute or more to make."""
QUICK = [world for world in WORLDS if world not in SLOW]
NETWORKS = {
    "policies/zoo/window-guard": "c21a84d3f0d33ed8",
    "policies/zoo/ewma-ppo": "b828df12b2c955a9",
    "policies/zoo/hidden-pool-ppo": "54ad560b6bd39705",
    "policies/zoo/snapshot-chi2-ppo": "22d458821e397451",
    "policies/zoo/solution-separation-ppo": "67a12047cfef36e0",
    "policies/zoo/solution-separation-quiet-ppo": "6b08ec0d449ffdbd",
}
"""First digits of the SHA-256 of the shipped files."""
PACKAGE = Path(spoofgym.__file__).parent
# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")


setup_of = cache(tools.calibrations.build_setup)


@cache
def shipped_of(world: str) -> list[tuple[Calibration, Detector]]:
    setup = setup_of(world)
    return [
        (found, each)
        for each in inner_detectors([*list_detectors(world, setup), *list_shipped("detector")])
        for rescaled in (False, True)[: 1 + each.drifts]
        for found in load_stored(
            setup.conditions, describe_identity(each), rescaled, SHIPPED_FOLDER
        )
    ]


@pytest.mark.parametrize("worlds", [QUICK, pytest.param([*SLOW], marks=pytest.mark.nightly)])
def test_every_shipped_calibration_is_found_by_its_digest(worlds):
    found = {made.path for world in worlds for made, _ in shipped_of(world)}
    slow = {path for folder in SLOW.values() for path in (SHIPPED_FOLDER / folder).iterdir()}
    every = {*SHIPPED_FOLDER.rglob("*.json")}
    assert len(every) == SHIPPED_FILES
    assert found == (slow if worlds == [*SLOW] else every - slow)


@pytest.mark.parametrize(
    ("world", "witnesses"),
    [
        *((world, REPLAYED) for world in QUICK),
        *(pytest.param(world, None, marks=pytest.mark.nightly) for world in WORLDS),
    ],
)
def test_shipped_calibrations_hold(world, witnesses):
    for rescaled in (False, True):
        pairs = [pair for pair in shipped_of(world) if (pair[0].rescale is not None) == rescaled]
        first = [dataclasses.replace(c, witnesses=c.witnesses[:witnesses]) for c, _ in pairs]
        check(setup_of(world), first, [detector for _, detector in pairs])


def test_shipped_networks_are_unchanged():
    files = {p.relative_to(PACKAGE).with_suffix("").as_posix(): p for p in PACKAGE.rglob("*.onnx")}
    digests = {name: hashlib.sha256(p.read_bytes()).hexdigest()[:16] for name, p in files.items()}
    assert digests == NETWORKS


@pytest.mark.parametrize("name", list_shipped())
def test_what_is_shipped_meets_the_world_of_its_card(name):
    if name in list_shipped("spoofer"):
        card = load_card(name, SpooferCard)
        profile = {} if card.file else {"action": "full-command"}
        env = gym.make(card.env_id, **{**profile, **card.env_kwargs})
        attach(name, env)
    else:
        task = get_task(load_card(name, DetectorCard).training["task"])
        env = gym.make(task.env_id, **{**task.env_kwargs, "detector": name})
        assert env.unwrapped.core.setup.detector.detector.label == name
    env.close()


@dataclass
class Mine:
    size: float = 1.0


def test_a_class_has_its_name_or_the_word_that_it_declares():
    assert describe(Mine()) == {"kind": "Mine", "size": 1.0}
    assert describe(type("Longer", (Timeline,), {})())["kind"] == "Longer"
    renamed = type("Longer", (Timeline,), {"described_as": "Timeline"})
    assert describe(renamed()) == describe(Timeline())
    assert describe(type("Again", (renamed,), {})())["kind"] == "Again"
    errors = {"kind": "CounterfeitErrors", "bias_sd_m": 0.25}
    assert PerChannel(errors=errors).errors.bias_sd_m == 0.25


def test_every_word_that_is_stored_still_stands_for_one_class():
    words = [
        get_kind(each)
        for module in pkgutil.walk_packages([str(PACKAGE)], "spoofgym.")
        if not module.name.endswith("__main__")
        for each in vars(importlib.import_module(module.name)).values()
        if inspect.isclass(each) and each.__module__ == module.name
    ]
    stored = (Path(__file__).parent / "golden" / "stored_words.txt").read_text().split()
    assert {word: words.count(word) for word in stored} == dict.fromkeys(stored, 1)
