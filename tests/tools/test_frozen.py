"""The comparison of two trees finds what differs, and nothing else."""

import os
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from typer.testing import CliRunner

from tools import frozen, frozen_probe
from tools.frozen import Case, Names, Scope, Tolerance
from tools.frozen_probe import CALLS, COMMANDS, IMPORTS, STEPS, Player, Record, list_cases

CASE = Case("spoofgym/Snapshot-v0", "same_step", 3)


def recorded(folder, values, names=None):
    """Columns of a record that has gone through its file."""
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


def differences(tmp_path, new, scope=None, tolerance=None, old=None):
    before, after = recorded(tmp_path, steps() if old is None else old), recorded(tmp_path, new)
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
    nexts = np.nextafter(old, np.float32(np.inf))
    assert not Tolerance(1e-12).unequal(old, nexts).any()
    assert Tolerance().unequal(old, nexts).all()
    assert Tolerance(1e-12).unequal(old, np.nextafter(np.nextafter(nexts, 999), 999)).all()


def test_flags_counts_and_texts_have_no_tolerance(tmp_path):
    tolerance = Tolerance(1.0, absolute=1e9)
    new = steps(
        cost=lambda x: x + 0.1, _cost=lambda mask: ~mask, count=lambda k: k + 1, label=lambda _: "x"
    )
    found = [each.key for each in differences(tmp_path, new, tolerance=tolerance)]
    assert found == ["info/_cost[0]", "info/count", "info/label"]


def test_an_alarm_that_comes_earlier_is_the_first_difference(tmp_path):
    def played(alarm):
        return [{"error": 0.1 * k + (k >= alarm), "alarm": k >= alarm} for k in range(6)]

    tolerance = Tolerance(1e-9)
    found = differences(tmp_path, played(3), tolerance=tolerance, old=played(4))
    assert [(each.key, each.step) for each in found] == [("info/alarm", 3), ("info/error", 3)]


def test_the_worst_deviation_of_every_column_is_reported(tmp_path):
    tolerance = Tolerance(1e-9)
    largest = max(np.abs(step["cost"]).max() for step in steps())
    new = steps(cost=lambda x: x + 1e-10, final_info=lambda i: {"error": i["error"] * 2})
    (found,) = differences(tmp_path, new, tolerance=tolerance)
    assert found.key.startswith("info/final_info/error")
    assert {*tolerance.worst} == {"info/cost", "info/final_info/error"}
    cost = tolerance.worst["info/cost"]
    assert cost.within
    assert cost.case == CASE.name
    assert cost.ratio == pytest.approx(1e-10 / largest, rel=1e-3)
    assert cost.absolute == pytest.approx(1e-10, rel=1e-3)
    assert not tolerance.worst["info/final_info/error"].within
    differences(tmp_path, steps(cost=lambda x: x + 1e-12), tolerance=tolerance)
    assert tolerance.worst["info/cost"] is cost
    assert tolerance.inexact == {CASE.name}


def test_another_type_and_another_step_differ(tmp_path):
    new = steps()
    del new[2]["count"]
    (found,) = differences(tmp_path, new)
    assert (found.step, found.key, found.old, found.new) == (2, "info/count", "there", "missing")
    for change in (np.float32, float, np.int64):
        (found,) = differences(
            tmp_path, [{**each, "count": change(each["count"])} for each in steps()]
        )
        assert found.key == "info/count"


def renamed(step):
    new = {key: value for key, value in step.items() if "cost" not in key}
    return {**new, "price": step["cost"], "_price": step["_cost"]}


def test_the_name_map_renames_keys_and_their_masks(tmp_path):
    new = [renamed(step) for step in steps()]
    found = {each.key for each in differences(tmp_path, new)}
    assert found == {"info/cost", "info/_cost", "info/price", "info/_price"}
    assert differences(tmp_path, new, Scope({"cost": "price"})) == []
    new[3]["price"] = one_bit(new[3]["price"])
    (found,) = differences(tmp_path, new, Scope({"cost": "price"}))
    assert found.key == "info/price[2]"


def test_a_part_of_a_name_is_not_renamed():
    scope = Scope({"cost": "price", "a/b": "c"})
    assert scope.rename(("info", "cost_m")) == ("info", "cost_m")
    assert scope.rename(("info", "true_cost", "_cost")) == ("info", "true_cost", "_price")
    assert scope.rename(("a", "b", "cost f()")) == ("c", "price f()")
    path = ("json", "[spoofgym/Snapshot-v0]", "pool")  # a slash within is not between parts
    assert Scope({"pool": "opponents"}).rename(path) == (*path[:2], "opponents")
    assert Scope(added={"[spoofgym/Snapshot-v0]/pool": "said why"}).is_added(path)


def test_added_and_dropped_keys_have_to_be_declared(tmp_path):
    new = [{**step, "more": 1.0} for step in steps()]
    for step in new:
        del step["count"]
    assert {each.key for each in differences(tmp_path, new)} == {"info/count", "info/more"}
    scope = Scope(added={"more": "said why"}, dropped={"count": "said why"})
    assert differences(tmp_path, new, scope) == []
    # a declaration that is wrong is found; what is both has other values
    why = {"count": "said why"}
    for scope, said in ((Scope(added=why), "declared as added"), (Scope(dropped=why), "still")):
        (found,) = differences(tmp_path, steps(), scope)
        assert found.new.startswith(said)
    both = Scope(added={"label": "reworded"}, dropped={"label": "reworded"})
    assert differences(tmp_path, steps(label=lambda _: "step"), both) == []


def test_elements_of_an_observation_are_named_and_mapped(tmp_path):
    values = [{"observation": np.float32([[k, 1.0, 2.0]])} for k in range(4)]
    swapped = [{"observation": each["observation"][:, [1, 0, 2]]} for each in values]
    old = recorded(tmp_path, values, {"observation": ["east", "north", "up"]})

    def found(values, names, scope=None):
        new = recorded(tmp_path, values, {"observation": names})
        return [each.key for each in frozen.compare(CASE, old, new, scope or Scope(), Tolerance())]

    assert found(values, ["east", "north", "up"]) == []
    assert found(swapped, ["north", "east", "up"]) == ["names of the observation"]
    assert found(values, ["east", "north", "height"], Scope({"up": "height"})) == []
    assert "info/observation/up" in found(values, ["east", "north", "height"])
    more = [{"observation": np.float32([[k, 1.0, 9.0, 2.0]])} for k in range(4)]
    names = ["east", "north", "new", "up"]
    assert found(more, names, Scope(added={"new": "said why"})) == []
    for key in ("final_obs", "terminal_observation"):
        last = np.array([None, np.float32([1.0, 2.0])], dtype=object)
        columns = recorded(tmp_path, [{key: last}], {"observation": ["east", "north"]})
        assert columns[("info", key, "[1]", "north")].values.tolist() == [2.0]


def test_scopes_are_ids_and_patterns_without_variants():
    names = Names(
        renamed={"*": {"a": "b"}, "spoofgym/Snap*": {"c": "d"}},
        dropped={"spoofgym/Snapshot-v0": {"e": "said why"}},
    )
    assert names.of("spoofgym/Snapshot-v0+twin") == Scope(
        {"a": "b", "c": "d"}, {}, {"e": "said why"}
    )
    assert names.of("duel_v0+weighted") == Scope({"a": "b"})


def test_ids_of_one_tree_alone_have_to_be_declared():
    both, old, new = (Case(f"spoofgym/{name}-v0", "single") for name in ("Both", "Old", "New"))
    cases, found = frozen.missing_cases([both, old], [both, new], Names())
    assert cases == [both]
    assert [(each.id, each.old, each.new) for each in found] == [
        (old.id, "there", "missing"),
        (new.id, "missing", "there"),
    ]
    names = Names(added={"*": {new.id: "said why"}}, dropped={"*": {old.id: "said why"}})
    assert frozen.missing_cases([both, old], [both, new], names) == ([both], [])


def test_an_error_of_either_tree_is_a_difference():
    replies = {"old": {}, "new": {"error": "ValueError: no"}}
    (found,) = frozen.judge(CASE, {}, replies, Names(), Tolerance())
    assert (found.old, found.new) == ("plays", "ValueError: no")
    same = {tree: {"error": "ValueError: no"} for tree in ("old", "new")}
    assert frozen.judge(CASE, {}, same, Names(), Tolerance())


def test_the_name_map_is_checked(tmp_path):
    file = tmp_path / "names.toml"
    for text, message in (
        ("[rename]\n", "'rename'"),
        ('[dropped."*"]\nkey = ""\n', r"dropped \* key needs a reason"),
        ('[volatile.bench]\nkey = ""\n', "volatile bench key needs a reason"),
    ):
        file.write_text(text)
        with pytest.raises(ValueError, match=message):
            Names.load(file)


def test_what_is_volatile_in_the_repository_is_the_digests_and_nothing_beside():
    names = Names.load(frozen.NAMES)
    assert names.of("bench").is_volatile(("json", "campaign"))
    assert not names.of("bench").is_volatile(("json", "cells", "[0]", "runs"))
    assert names.of("dataset").is_volatile(("npz", "[3]", "digest"))
    assert not names.of("dataset").is_volatile(("npz", "[3]", "observation"))
    assert {*names.volatile} == {"bench", "dataset", "paper"}
    assert {use for use in names.imports} <= {*IMPORTS}


def test_what_is_volatile_is_not_compared_in_either_tree(tmp_path):
    scope = Scope({"count": "number"}, volatile={"number": "the clock's"})
    new = steps()
    for step in new:
        step["number"] = 9.0 + step.pop("count")
    assert differences(tmp_path, new, scope) == []
    for step in new:
        del step["number"]
    assert differences(tmp_path, new, scope) == []
    new[3]["cost"] = one_bit(new[3]["cost"])
    (found,) = differences(tmp_path, new, scope)
    assert found.key == "info/cost[2]"


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
    for at, error in (("nowhere:RATE", ModuleNotFoundError), ("core:NO_RATE", AttributeError)):
        for use in ("default_rate", "own_calibrations"):  # what is patched has to be there
            with pytest.raises(error):
                frozen_probe.set_thresholds({**imports, use: f"spoofgym.{at}"}, usual=False)


def test_a_score_is_recorded_by_its_fields(tmp_path):
    @dataclass
    class Score:
        value: float
        runs: object

    record = Record()
    record.add(-1, ("score",), Score(1.5, [Score(2.5, np.arange(3))]))
    record.save(tmp_path / "record.npz")
    columns = frozen.load_record(tmp_path / "record.npz")
    assert columns[("score", "value")].values.tolist() == [1.5]
    assert columns[("score", "runs", "[0]", "runs")].values.tolist() == [[0, 1, 2]]


def test_a_killed_command_has_to_be_killed_while_it_works(tmp_path):
    player = Player(Case("bench", "killed"), {})

    def started(code):
        done = [sys.executable, "-c", code]
        return subprocess.Popen(
            done, cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True
        )

    with pytest.raises(RuntimeError, match="ended before it was killed"):
        player.kill(started("pass"), tmp_path / "results")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "cell.npz").touch()
    player.kill(started("import time; time.sleep(600)"), tmp_path / "results")


def test_every_id_has_every_form():
    cases = list_cases(["spoofgym/Snapshot-v0", "spoofgym/BenchT1-v1"])
    forms = {(case.form, case.batch) for case in cases if case.id == "spoofgym/BenchT1-v1"}
    modes = {
        (mode, b) for mode in ("next_step", "same_step", "disabled", "sb3") for b in (1, 3, 17)
    }
    assert forms == {("single", None), *modes}
    assert len({case.name for case in cases}) == len(cases)
    for case in cases:
        assert frozen.is_wanted(case, quick=False)


def test_the_quick_ones_have_every_command_every_score_and_the_default_of_users():
    cases = [each for each in list_cases(["spoofgym/BenchT3-v1"]) if frozen.is_wanted(each, True)]
    assert {(case.id, case.form) for case in cases} >= {*COMMANDS, *CALLS}
    usual = {case.name for case in cases if case.form == "shipped"}
    assert usual == {
        *("TightlyCoupled-v0/shipped", "BenchT3-v1/shipped", "bench/shipped", "run/shipped"),
        *("evaluate/shipped", "evaluate_detector/shipped"),
    }
    assert frozen.is_wanted(Case("evaluate", "shipped"), False, ["bench", "evaluate*"])
    assert not frozen.is_wanted(Case("evaluate", "shipped"), True, ["bench", "evaluate"])


def test_actions_are_mild_random_and_pushes():
    player = Player(CASE, {})
    actions = np.array([player.action(k, (3, 2)) for k in range(STEPS)])
    assert np.abs(actions).max(axis=(0, 2)).tolist() == pytest.approx([1.0, 1.0, 1.0], abs=0.01)
    assert (np.abs(actions[:325, 0]) <= 0.03).all()
    again = Player(CASE, {})
    np.testing.assert_array_equal(actions[0], again.action(0, (3, 2)))


def test_the_command_line_names_an_unknown_commit_and_an_unknown_case():
    runner = CliRunner()
    done = runner.invoke(frozen.app, ["--against", "no-such-commit"])
    assert done.exit_code == 2
    assert "no-such-commit" in done.output
    done = runner.invoke(frozen.app, ["--against", "HEAD", "--speed-of", "no-such-speed"])
    assert done.exit_code == 2
    assert "no-such-speed" in done.output
