"""A name has one meaning, and is one of the field's."""

import ast
from collections import defaultdict

from . import sources

TWINS = {
    "AlarmRecorder",
    "DetectorWrapper",
    "EpochInfo",
    "PassiveDetector",
    "RecordEpochs",
    "ResidualAction",
    "StealthBudget",
    "WatchWrapper",
}
"""The same thing for single environments, vectors and stable-baselines3."""
HOUSE_WORDS = {"told", "nobody", "somebody", "everybody", "whom", "anew", "asked", "kept"}
SETTINGS = {("best_response.py", "kept")}  # of `AttackBudget`: names of settings are data


def test_no_two_public_classes_or_functions_share_a_name():
    found = defaultdict(set)
    for path in sources.files():
        for node in sources.tree_of(path).body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
                found[node.name].add(sources.name_of(path))
    several = {name: sorted(where) for name, where in found.items() if len(where) > 1}
    assert {name for name in several if name not in TWINS} == set(), several
    assert set(several) == TWINS


def test_identifiers_have_none_of_the_words_that_the_house_has_left():
    for path in sources.files():
        for node in ast.walk(sources.tree_of(path)):
            name = getattr(node, "name", None) or getattr(node, "id", None)
            name = name or getattr(node, "arg", None) or getattr(node, "attr", None) or ""
            if isinstance(name, str) and (path.name, name) not in SETTINGS:
                assert not HOUSE_WORDS.intersection(name.split("_")), (path.name, name)


def test_functions_are_named_by_a_verb():
    for path in sources.files():
        for node in ast.walk(sources.tree_of(path)):
            if isinstance(node, ast.FunctionDef):
                assert not node.name.endswith(("_of", "_in")), (path.name, node.name)
