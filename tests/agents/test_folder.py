"""Folder of a command that goes on: the same settings, and nobody else's files."""

import json

import pytest

from agents import folder as module
from agents.folder import CONFIG, error_lines, open_folder


@pytest.fixture(autouse=True)
def versions(monkeypatch):
    monkeypatch.setattr(module, "used_versions", lambda: {"numpy": "2.0"})


def test_the_same_settings_go_on_and_others_are_named(tmp_path, monkeypatch):
    open_folder(tmp_path, {"width": 8, "names": ("a", "b")})
    before = (tmp_path / CONFIG).read_bytes()
    open_folder(tmp_path, {"width": 8, "names": ("a", "b")})
    with pytest.raises(ValueError, match=r"width: 8 there, 9 here; choose another --out"):
        open_folder(tmp_path, {"width": 9, "names": ("a", "b")})
    monkeypatch.setattr(module, "used_versions", lambda: {"numpy": "3.0"})
    with pytest.raises(ValueError, match=r"versions.numpy: '2.0' there, '3.0' here"):
        open_folder(tmp_path, {"width": 8, "names": ("a", "b")})
    assert (tmp_path / CONFIG).read_bytes() == before


def test_a_folder_of_somebody_else_is_refused_and_an_empty_one_is_not(tmp_path):
    open_folder(tmp_path / "new", {})
    (tmp_path / "empty").mkdir()
    open_folder(tmp_path / "empty", {})
    assert json.loads((tmp_path / "empty" / CONFIG).read_text())["arguments"] == {}
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("keep")
    with pytest.raises(ValueError, match=r"not empty and holds no config\.json"):
        open_folder(tmp_path / "mine", {})
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thesis.txt"]
    (tmp_path / "new" / CONFIG).write_text("{")
    with pytest.raises(ValueError, match="is damaged"):
        open_folder(tmp_path / "new", {})


def test_a_mistake_is_one_line_and_a_fault_of_ours_is_not(tmp_path):
    with pytest.raises(SystemExit, match=r"^error: a b$"), error_lines():
        raise ValueError("a\n b")
    with pytest.raises(SystemExit, match=r"^error: .*nowhere"), error_lines():
        (tmp_path / "nowhere").read_text()
    with pytest.raises(SystemExit, match="the same command goes on"), error_lines():
        raise KeyboardInterrupt
    with pytest.raises(AssertionError), error_lines():
        raise AssertionError
