"""What counts as size."""

import json

from typer import Typer
from typer.testing import CliRunner

from tools import size


def test_lines_statements_and_files_are_counted(tmp_path):
    for path, text in {
        "a/one.py": '"""Doc."""\n\nif True:\n    x = [\n        1,\n    ]\n',
        "a/deep/two.py": "def f(): return 1\n",
        "a/notes.txt": "no\n" * 9,
        "b/three.py": "",
    }.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    assert size.measure_size("a", tmp_path) == (7, 5, 2)
    assert size.measure_size("a + b", tmp_path) == (7, 5, 3)


def test_the_check_fails_where_a_part_is_over_its_budget(monkeypatch):
    app = Typer()
    app.command()(size.main)
    found = size.measure_size("tools")
    for more, code in ((0, 0), (-1, 1)):
        monkeypatch.setattr(size, "BUDGETS", {"tools": size.Size(found.lines + more)})
        ran = CliRunner().invoke(app, ["--json", "--check"])
        assert (ran.exit_code, json.loads(ran.stdout)["over"]) == (code, ["tools"] * code)
        assert CliRunner().invoke(app, []).exit_code == 0
