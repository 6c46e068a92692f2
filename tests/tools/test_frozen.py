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
from tools.frozen_probe import CALLS, COMMANDS, IMPORTS, Player, Record, list_cases

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


def test_another_type_and_another_step_differ(tmp_path):
    new = steps()
    del new[2]["count"]
    (found,) = differences(tmp_path, new)
    assert (found.step, found.key, found.old, found.new) == (2, "info/count", "there", "missing")
    for change in (np.float32, float, np.int64):
        new = [{**each, "count": change(each["count"])} for each in steps()]
        (found,) = differences(tmp_path, new)
        assert found.key == "info/count"

    @dataclass
    class Score:
        value: float
        runs: object

    columns = recorded(tmp_path, [Score(1.5, [Score(2.5, np.arange(3))])])  # by its fields
    assert columns[("info", "value")].values.tolist() == [1.5]
    assert columns[("info", "runs", "[0]", "runs")].values.tolist() == [[0, 1, 2]]


def test_the_name_map_renames_keys_and_their_masks(tmp_path):
    new = steps()
    for step in new:
        step |= {"price": step.pop("cost"), "_price": step.pop("_cost")}
    found = {each.key for each in differences(tmp_path, new)}
    assert found == {"info/cost", "info/_cost", "info/price", "info/_price"}
    assert differences(tmp_path, new, Scope({"cost": "price"})) == []
    new[3]["price"] = one_bit(new[3]["price"])
    (found,) = differences(tmp_path, new, Scope({"cost": "price"}))
    assert found.key == "info/price[2]"
    scope = Scope({"cost": "price", "a/b": "c", "pool": "opponents"})
    for path, expected in (
        ("cost_m", "cost_m"),  # a part of a name is not renamed
        ("a b cost", "c price"),
        # a slash within is not between parts
        ("json [spoofgym/Snapshot-v0] pool", "json [spoofgym/Snapshot-v0] opponents"),
    ):
        assert scope.rename(tuple(path.split())) == tuple(expected.split())


def test_added_and_dropped_keys_have_to_be_declared(tmp_path):
    new = [{**step, "more": 1.0} for step in steps()]
    for step in new:
        del step["count"]
    assert {each.key for each in differences(tmp_path, new)} == {"info/count", "info/more"}
    why = {"count": "said why"}
    assert differences(tmp_path, new, Scope(added={"more": "said why"}, dropped=why)) == []
    # a declaration that is wrong is found; what is both has other values
    for scope, said in ((Scope(added=why), "declared as added"), (Scope(dropped=why), "still")):
        (found,) = differences(tmp_path, steps(), scope)
        assert found.new.startswith(said)
    both = Scope(added={"label": "reworded"}, dropped={"label": "reworded"})
    assert differences(tmp_path, steps(label=lambda _: "step"), both) == []


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


def test_scopes_are_ids_and_patterns_without_variants(tmp_path):
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


def test_what_is_volatile_is_not_compared_in_either_tree(tmp_path):
    scope = Scope({"count": "number"}, volatile={"number": "the clock's"})
    new = [{**step, "number": 9.0 + step["count"]} for step in steps()]
    for step in new:
        del step["count"]
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
    gone = {**imports, "default_rate": "spoofgym.core:NO_RATE"}
    with pytest.raises(AttributeError):  # what is patched has to be there
        frozen_probe.set_thresholds(gone, usual=False)


def test_a_killed_command_has_to_be_killed_while_it_works(tmp_path):
    player, out = Player(Case("bench", "killed"), {}), tmp_path / "results"

    def started(code):
        words = [sys.executable, "-c", code]
        return subprocess.Popen(words, stderr=subprocess.PIPE, text=True, start_new_session=True)

    with pytest.raises(RuntimeError, match="ended before it was killed"):
        player.kill(started("pass"), out)
    out.mkdir()
    (out / "cell.npz").touch()
    player.kill(started("import time; time.sleep(600)"), out)


def test_every_id_has_every_form_and_the_quick_ones_every_command_and_score():
    every = list_cases(["spoofgym/Snapshot-v0", "spoofgym/BenchT3-v1"])
    assert len({case.name for case in every}) == len(every)
    assert all(frozen.is_wanted(case, quick=False) for case in every)
    forms = {(case.form, case.batch) for case in every if case.id == "spoofgym/BenchT3-v1"}
    modes = {
        (mode, b) for mode in ("next_step", "same_step", "disabled", "sb3") for b in (1, 3, 17)
    }
    assert forms >= {("single", None), *modes}
    cases = [each for each in list_cases(["spoofgym/BenchT3-v1"]) if frozen.is_wanted(each, True)]
    assert {(case.id, case.form) for case in cases} >= {*COMMANDS, *CALLS}
    assert "TightlyCoupled-v0/shipped" in {case.name for case in cases if case.form == "shipped"}
    assert frozen.is_wanted(Case("evaluate", "shipped"), False, ["bench", "evaluate*"])
    assert not frozen.is_wanted(Case("evaluate", "shipped"), True, ["bench", "evaluate"])


def test_the_command_line_names_an_unknown_commit_and_an_unknown_case():
    for words in (["no-such-commit"], ["HEAD", "--speed-of", "no-such-speed"]):
        done = CliRunner().invoke(frozen.app, ["--against", *words])
        assert done.exit_code == 2
        assert words[-1] in done.output
