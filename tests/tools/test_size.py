"""What counts as size."""

from __future__ import annotations

import json

from typer import Typer
from typer.testing import CliRunner

from tools import size


def test_lines_statements_and_files_are_counted(tmp_path):
    (tmp_path / "a" / "deep").mkdir(parents=True)
    (tmp_path / "a" / "one.py").write_text('"""Doc."""\n\nif True:\n    x = [\n        1,\n    ]\n')
    (tmp_path / "a" / "deep" / "two.py").write_text("def f(): return 1\n")
    (tmp_path / "a" / "notes.txt").write_text("no\n" * 9)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "three.py").write_text("")
    assert size.size_of("a", tmp_path) == (7, 5, 2)
    assert size.size_of("a + b", tmp_path) == (7, 5, 3)


def test_the_check_fails_where_a_part_is_over_its_budget(monkeypatch):
    app = Typer()
    app.command()(size.main)
    found = size.size_of("tools")
    for more, code in ((0, 0), (-1, 1)):
        monkeypatch.setattr(size, "BUDGETS", {"tools": size.Size(found.lines + more)})
        ran = CliRunner().invoke(app, ["--json", "--check"])
        assert ran.exit_code == code
        assert json.loads(ran.stdout)["over"] == ["tools"] * code
        assert CliRunner().invoke(app, []).exit_code == 0
