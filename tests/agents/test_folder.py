"""Experiments of the laboratory: functions that return JSON; and errors of one line."""

import pytest

from agents.folder import Part, Records, error_lines


def counted(calls, config=None, **identities):
    def number(name):
        calls.append(name)
        return identities[name]

    parts = {name: Part({"is": x}, lambda *_, n=name: number(n)) for name, x in identities.items()}
    parts["sum"] = Part(identities, lambda before, _: sum(before.values()), tuple(identities))
    return Records("numbers", config or {}, parts)


def test_what_is_made_is_not_made_again_and_reads_what_came_before(tmp_path):
    calls = []
    found = counted(calls, a=1, b=2).play(tmp_path)
    assert found == {"a": 1, "b": 2, "sum": 3}
    assert counted(calls, a=1, b=2).play(tmp_path) == found
    # what depends on something else stands beside it
    assert counted(calls, a=2).play(tmp_path)["a"] == 2
    counted(calls, a=1).play(tmp_path)
    assert calls == ["a", "b", "a"]
    with pytest.raises(ValueError, match=r"holds other results"):
        counted([], {"width": 9}, a=1).play(tmp_path)


def test_a_mistake_is_one_line_and_a_fault_of_ours_is_not(tmp_path):
    with pytest.raises(SystemExit, match=r"^error: a b$"), error_lines():
        raise ValueError("a\n b")
    with pytest.raises(SystemExit, match=r"^error: .*nowhere"), error_lines():
        (tmp_path / "nowhere").read_text()
    for word, said in (("", "the same command goes on"), ("1 of 2 cells", "^1 of 2 cells$")):
        with pytest.raises(SystemExit, match=said), error_lines():
            raise KeyboardInterrupt(*filter(None, [word]))
    with pytest.raises(AssertionError), error_lines():
        raise AssertionError
