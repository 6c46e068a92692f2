"""The comparison of two trees finds what differs, and nothing else."""

import os
import subprocess
import sys
from itertools import product

import numpy as np
import pytest
from typer.testing import CliRunner

from tools import frozen, frozen_probe
from tools.frozen import Case, Column, Names, Scope, Tolerance
from tools.frozen_probe import CALLS, COMMANDS, IMPORTS, Player, Record, list_cases

CASE = Case("spoofgym/Snapshot-v0", "same_step", 3)


def recorded(folder, values, names=None):
    record = Record()
    for step, value in enumerate(values):
        record.add(step, ("info",), value)
    record.names = names or {}
    record.save(folder / "record.npz")
    return frozen.load_record(folder / "record.npz")


def steps(**changes):
    rng = np.random.default_rng(1)
    made = [
        {
            "cost": rng.normal(size=3),
            "_cost": np.ones(3, dtype=bool),
            "count": k,
            "label": "ramp",
            "final_obs": np.array([None, np.float32([k, 2.0]), None], dtype=object),
            "final_info": {"error": rng.normal(size=(3, 2)).astype(np.float32)},
        }
        for k in range(5)
    ]
    for key, change in changes.items():
        made[3][key] = change(made[3][key])
    return made


def differences(tmp_path, new, scope=None, tolerance=None):
    before, after = recorded(tmp_path, steps()), recorded(tmp_path, new)
    return frozen.compare(CASE, before, after, scope or Scope(), tolerance or Tolerance())


def one_bit(array):
    changed = array.copy()
    changed.view(np.uint8).reshape(-1)[-array.itemsize] ^= 1
    return changed


@pytest.mark.parametrize(
    ("key", "change", "named"),
    [
        ("cost", one_bit, "info/cost[2]"),
        ("_cost", lambda mask: mask & [True, False, True], "info/_cost[1]"),
        ("count", lambda k: k + 1, "info/count"),
        ("label", lambda _: "step", "info/label"),
        (
            "final_obs",
            lambda o: np.array([None, one_bit(o[1]), None], object),
            "info/final_obs/[1]",
        ),
        ("final_info", lambda i: {"error": one_bit(i["error"])}, "info/final_info/error[2][1]"),
    ],
)
def test_one_bit_is_found_and_named(tmp_path, key, change, named):
    assert differences(tmp_path, steps()) == []
    (found,) = differences(tmp_path, steps(**{key: change}))
    assert found.step == 3
    assert found.key.startswith(named)
    assert found.old != found.new
    assert str(found).startswith("spoofgym/Snapshot-v0 same_step B=3 step 3 info/")
    # flags, counts and texts have no tolerance
    tolerance = Tolerance(1.0, absolute=1e9)
    exact = key in ("_cost", "count", "label")
    assert len(differences(tmp_path, steps(**{key: change}), tolerance=tolerance)) == exact


def test_the_tolerance_is_relative_to_the_largest_value_and_takes_nan_for_no_number():
    nan, inf = np.nan, np.inf
    for tolerance, old, new, differ in (
        (Tolerance(), [0.0, nan, 1.0], [-0.0, nan, 1.0], [True, False, False]),
        (Tolerance(1e-3), [0.0, nan, 1.0], [0.0, 2.0, 1.0], [False, True, False]),
        (Tolerance(1e-6), [1000.0, 1.0], [1000.0, 1.0 + 0.9e-3], [False, False]),
        (Tolerance(1e-6), [1000.0, 1.0], [1000.0, 1.0 + 1.1e-3], [False, True]),
        (Tolerance(1e-6, absolute=2e-3), [1000.0, 1.0], [1000.0, 1.0 + 1.1e-3], [False, False]),
        (Tolerance(1.0), [1.0, nan, inf, inf], [nan, nan, -inf, inf], [True, False, True, False]),
        (Tolerance(1.0), [1.0], [inf], [True]),
    ):
        assert tolerance.unequal(np.array(old), np.array(new)).tolist() == differ
    # single precision may have been rounded to the next number
    old = np.float32([1.0, 100.0])
    one, three = (old + k * np.spacing(old) for k in (1, 3))
    assert not Tolerance(1e-12).unequal(old, one).any()
    assert Tolerance().unequal(old, one).all()
    assert Tolerance(1e-12).unequal(old, three).all()


def test_another_step_differs_and_a_dataclass_is_kept_by_its_fields(tmp_path):
    new = steps()
    del new[2]["count"]
    (found,) = differences(tmp_path, new)
    assert (found.step, found.key, found.old, found.new) == (2, "info/count", "there", "missing")
    score = Column(1.5, [Column(np.arange(3), 2.5, ())], ())
    columns = recorded(tmp_path, [score])
    assert columns[("info", "steps")].values.tolist() == [1.5]
    assert columns[("info", "values", "[0]", "steps")].values.tolist() == [[0, 1, 2]]


def without(step, *keys):
    return {key: x for key, x in step.items() if key not in keys}


def priced(step):
    return {**without(step, "cost", "_cost"), "price": step["cost"], "_price": step["_cost"]}


def numbered(step, cost=lambda x: x):
    return {**without(step, "count"), "number": 9.0 + step["count"], "cost": cost(step["cost"])}


WHY = "said why"
PRICE, NUMBER = Scope({"cost": "price"}), Scope({"count": "number"}, volatile={"number": WHY})
DECLARED = Scope(added={"number": WHY}, dropped={"count": WHY})


@pytest.mark.parametrize(
    ("change", "scope", "expected"),
    [
        # names, with their masks
        (priced, Scope(), "cost _cost price _price"),
        (priced, PRICE, ""),
        (lambda step: {**priced(step), "price": one_bit(step["cost"])}, PRICE, "price[2]"),
        # what is added and dropped has to be declared, and declarations have to be right
        (numbered, Scope(), "count number"),
        (numbered, DECLARED, ""),
        (dict, Scope(added={"count": WHY}), "count"),
        (dict, Scope(dropped={"count": WHY}), "count"),
        (lambda step: {**step, "label": "step"}, Scope({}, {"label": WHY}, {"label": WHY}), ""),
        # what is volatile is not compared in either tree
        (numbered, NUMBER, ""),
        (lambda step: without(step, "count"), NUMBER, ""),
        (lambda step: numbered(step, one_bit), NUMBER, "cost[2]"),
        # types
        (lambda step: {**step, "count": np.float32(step["count"])}, Scope(), "count"),
        (lambda step: {**step, "count": float(step["count"])}, Scope(), "count"),
        (lambda step: {**step, "count": np.int64(step["count"])}, Scope(), "count"),
    ],
)
def test_what_differs_is_named_but_for_what_is_declared(tmp_path, change, scope, expected):
    found = differences(tmp_path, [change(step) for step in steps()], scope)
    assert {each.key for each in found} == {f"info/{key}" for key in expected.split()}


def test_only_whole_parts_of_a_name_are_renamed_and_scopes_are_ids_and_patterns(tmp_path):
    scope = Scope({"cost": "price", "a/b": "c", "pool": "opponents"})
    for path, expected in (
        ("cost_m", "cost_m"),
        ("a b cost", "c price"),
        ("json [spoofgym/Snapshot-v0] pool", "json [spoofgym/Snapshot-v0] opponents"),
    ):
        assert scope.rename(tuple(path.split())) == tuple(expected.split())
    names = Names(
        renamed={"*": {"a": "b"}, "spoofgym/Snap*": {"c": "d"}},
        dropped={"spoofgym/Snapshot-v0": {"e": "said why"}},
    )
    scope = Scope({"a": "b", "c": "d"}, {}, {"e": "said why"})
    assert names.of("spoofgym/Snapshot-v0+twin") == scope
    assert names.of("duel_v0+weighted") == Scope({"a": "b"})
    file = tmp_path / "names.toml"
    for text, message in (
        ("[rename]\n", "'rename'"),
        ('[dropped."*"]\nkey = ""\n', r"dropped \* key needs a reason"),
    ):
        file.write_text(text)
        with pytest.raises(ValueError, match=message):
            Names.load(file)
    assert {*Names.load(frozen.NAMES).volatile} == {"bench", "dataset", "paper"}


def test_elements_of_an_observation_are_named_and_mapped(tmp_path):
    east, north, up = np.arange(4.0), np.ones(4), np.full(4, 2.0)

    def columns(names, *values):
        rows = [{"observation": np.float32([row])} for row in zip(*values, strict=True)]
        return recorded(tmp_path, rows, {"observation": names})

    old = columns(["east", "north", "up"], east, north, up)

    def found(names, *values, scope=None):
        new = columns(names, *values)
        return [each.key for each in frozen.compare(CASE, old, new, scope or Scope(), Tolerance())]

    swapped, named = ["north", "east", "up"], ["east", "north", "height"]
    assert found(["east", "north", "up"], east, north, up) == []
    assert found(swapped, north, east, up) == ["names of the observation"]
    assert found(named, east, north, up, scope=Scope({"up": "height"})) == []
    assert "info/observation/up" in found(named, east, north, up)
    more = ["east", "north", "new", "up"]
    assert found(more, east, north, 9.0 * north, up, scope=Scope(added={"new": "said why"})) == []
    for key in ("final_obs", "terminal_observation"):
        last = np.array([None, np.float32([1.0, 2.0])], dtype=object)
        kept = recorded(tmp_path, [{key: last}], {"observation": ["east", "north"]})
        assert kept[("info", key, "[1]", "north")].values.tolist() == [2.0]


def test_an_error_and_an_id_of_one_tree_alone_are_differences():
    (found,) = frozen.judge(
        CASE, {}, {"old": {}, "new": {"error": "ValueError: no"}}, Names(), Tolerance()
    )
    assert (found.old, found.new) == ("plays", "ValueError: no")
    same = {tree: {"error": "ValueError: no"} for tree in ("old", "new")}
    assert frozen.judge(CASE, {}, same, Names(), Tolerance())
    both, old, new = (Case(f"spoofgym/{name}-v0", "single") for name in ("Both", "Old", "New"))
    cases, found = frozen.missing_cases([both, old], [both, new], Names())
    assert cases == [both]
    assert [(each.id, each.old, each.new) for each in found] == [
        (old.id, "there", "missing"),
        (new.id, "missing", "there"),
    ]
    names = Names(added={"*": {new.id: "said why"}}, dropped={"*": {old.id: "said why"}})
    assert frozen.missing_cases([both, old], [both, new], names) == ([both], [])


def test_thresholds_are_as_published_or_those_that_users_have(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    imports = {**IMPORTS, **Names.load(frozen.NAMES).imports}
    owner, rate = frozen_probe.place(imports["default_rate"])
    variable = getattr(*frozen_probe.place(imports["own_calibrations"]))
    monkeypatch.setattr(owner, rate, 0.2)
    monkeypatch.setattr(frozen_probe, "USUAL", {})
    monkeypatch.setenv(variable, "those of a user")
    for usual, expected in ((True, 0.2), (False, None), (True, 0.2)):
        frozen_probe.set_thresholds(imports, usual=usual)
        assert getattr(owner, rate) == expected
        assert os.environ[variable] == str(tmp_path / "own")
    with pytest.raises(AttributeError):  # what is patched has to be there
        frozen_probe.set_thresholds({**imports, "default_rate": "spoofgym.core:NO"}, usual=False)


def test_a_command_that_ends_before_it_is_killed_is_told(tmp_path):
    words = [sys.executable, "-c", "pass"]
    child = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, start_new_session=True)
    with pytest.raises(RuntimeError, match="ended before it was killed"):
        Player(Case("bench", "killed"), {}).kill(child, tmp_path)


def test_every_id_has_every_form_and_the_quick_ones_every_command_and_score():
    every = list_cases(["spoofgym/Snapshot-v0", "spoofgym/BenchT3-v1"])
    assert len({case.name for case in every}) == len(every)
    assert all(frozen.is_wanted(case, quick=False) for case in every)
    forms = {(case.form, case.batch) for case in every if case.id == "spoofgym/BenchT3-v1"}
    modes = product(("next_step", "same_step", "disabled", "sb3"), (1, 3, 17))
    assert forms >= {("single", None), *modes}
    cases = [each for each in list_cases(["spoofgym/BenchT3-v1"]) if frozen.is_wanted(each, True)]
    assert {(case.id, case.form) for case in cases} >= {*COMMANDS, *CALLS}
    assert "Zhong2025-v0/shipped" in {case.name for case in cases if case.form == "shipped"}
    assert frozen.is_wanted(Case("evaluate", "shipped"), False, ["bench", "evaluate*"])
    assert not frozen.is_wanted(Case("evaluate", "shipped"), True, ["bench", "evaluate"])


def test_the_command_line_names_an_unknown_commit_and_an_unknown_case():
    for words in (["no-such-commit"], ["HEAD", "--speed-of", "no-such-speed"]):
        done = CliRunner().invoke(frozen.app, ["--against", *words])
        assert done.exit_code == 2
        assert words[-1] in done.output
