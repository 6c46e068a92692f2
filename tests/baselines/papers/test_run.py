"""A reproduction runs in processes, goes on where it was, and prints what the house expects."""

import json
import os
import sys
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from baselines.papers import __main__ as command
from baselines.papers import paper as papers
from baselines.papers import run as running
from baselines.papers import sources
from baselines.papers.frame import Band, Origin, Part, Row, Settings, fill_origins
from baselines.papers.paper import check_rows, format_letter, rows_from_record, rows_record
from baselines.papers.run import PaperRun, PartError

from . import toy

QUICK = Settings(quick=True, seed=0)


@pytest.fixture
def thrown(monkeypatch, tmp_path):
    """The toy, as one of the papers; numbers of throws of the parts that were run."""
    monkeypatch.setitem(sys.modules, f"baselines.papers.{toy.KEY}", toy)
    for module in (papers, command):
        monkeypatch.setattr(module, "KEYS", (toy.KEY,))
    marks = tmp_path / "marks"
    marks.write_text("")
    monkeypatch.setattr(toy, "marks", str(marks))
    return lambda: sorted(marks.read_text().split())


def play(out, settings=QUICK, jobs=1, **options):
    run = PaperRun(toy.KEY, settings, out)
    return run, run.play(jobs, **options)


def test_parts_run_in_processes_that_have_a_thread_each(thrown, tmp_path, monkeypatch):
    parts = [Part(name, toy.place, {"seed": 0}) for name in ("a", "b")]
    monkeypatch.setattr(toy, "parts", lambda settings: parts)
    before = os.environ.get("OMP_NUM_THREADS")
    _, found = play(tmp_path, jobs=2)
    assert os.getpid() not in {result["process"] for result in found.values()}
    assert {result["threads"] for result in found.values()} == {"1"}
    assert os.environ.get("OMP_NUM_THREADS") == before


def test_stored_parts_are_not_run_again_and_a_damaged_one_is_named(thrown, tmp_path, monkeypatch):
    run, first = play(tmp_path)
    assert thrown() == ["100", "200"]
    means = [run.rows(first)[0].ours]
    for other in (replace(QUICK, seed=1), replace(QUICK, quick=False)):  # of their own
        another, found = play(tmp_path, other)
        means.append(another.rows(found)[0].ours)
    assert len(set(means)) == 3
    again, found = play(tmp_path)
    assert thrown() == ["100", "100", "1000", "200", "200", "2000"]
    assert again.record(found) == run.record(first)
    assert found["100 throws"]["eyes"].tolist() == toy.throw(100, 0)["eyes"].tolist()
    run.store.build_path("100 throws").unlink()
    play(tmp_path)
    assert len(thrown()) == 7
    run.store.build_path("200 throws").write_bytes(b"half a file")
    with pytest.raises(ValueError, match=r"200-throws.* is damaged .*; delete it and run again"):
        play(tmp_path)
    monkeypatch.setattr(running, "digest_of_modules", lambda modules: "another")
    for use in (lambda: PaperRun(toy.KEY, QUICK, tmp_path).load_data(), lambda: play(tmp_path)):
        with pytest.raises(ValueError, match=r"holds other results \(config\.sources: "):
            use()
    play(tmp_path, overwrite=True)
    assert len(thrown()) == 9


def test_a_part_that_fails_is_named_and_those_before_it_are_kept(thrown, tmp_path, monkeypatch):
    first, last = (replace(part, weight=1.0) for part in toy.parts(QUICK))
    parts = [first, Part("odd", toy.fail, {"seed": 0}), last]
    monkeypatch.setattr(toy, "parts", lambda settings: parts)
    with pytest.raises(PartError, match=r"part 'odd' of toy2025 has failed: no die"):
        play(tmp_path)
    assert thrown() == ["100"]
    with pytest.raises(ValueError, match="is not in"):
        PaperRun(toy.KEY, QUICK, tmp_path).load_data()


def test_a_run_prints_json_or_tables_and_draws_figures(thrown, tmp_path):
    def called(key, *more):
        words = [key, "--quick", "--jobs", "1", "--out", str(tmp_path / "out"), *more]
        result = CliRunner().invoke(command.app, words)
        assert result.exit_code == 0
        return result.stdout

    told = json.loads(called(toy.KEY, "--json"))
    assert list(told) == ["paper", "runs", "seed", "origins", "rows"]
    assert (told["paper"], told["runs"], told["seed"]) == (toy.KEY, 300, 0)
    names = "table row quantity paper ours low high origin printed_inside agrees kept note"
    columns = {
        "printed_inside": [True, True, None, False, False, None],
        "agrees": [None, None, None, None, True, None],
        "kept": [None] * 5 + [True],
        "origin": ["A", "A", None, "A", "B", "C"],
    }
    assert all(list(row) == names.split() for row in told["rows"])
    assert columns == {name: [row[name] for row in told["rows"]] for name in columns}
    kinds = {letter: origin["kind"] for letter, origin in told["origins"].items()}
    assert kinds == {"A": "tolerance", "B": "independent", "C": "bound"}
    assert json.loads(called("all", "--json")) == [told]
    text = called(toy.KEY, "--figures", str(tmp_path / "fig"))
    assert "Dice et al. (2025), Table 2" in text
    assert "2 of 4 printed values lie inside the tolerance of the reproduction." in text
    assert "Bands B (independent): Another die." in text
    assert (tmp_path / "fig" / toy.KEY / "dice_7.png").read_bytes().startswith(b"\x89PNG")


def test_an_unknown_key_lists_the_valid_ones():
    result = CliRunner().invoke(command.app, ["zhong"])
    assert result.exit_code == 2
    assert "valid: all, ke2022, shadmehri2025, song2021, wu2024, zhong2025" in result.stderr
    with pytest.raises(ValueError, match="did you mean 'wu2024'"):
        papers.load_paper("wu2023")


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (Part("100 throws", toy.throw, {}), "two parts .* have the same name: 100 throws"),
        (Part("lambda", lambda: {}, {}), "its function must be one of a module"),
        (Part("array", toy.throw, {"runs": toy}), "cannot be written as JSON"),
        (Part("tuple", toy.throw, {"runs": (1, 2)}), "its settings change when written as JSON"),
        (Part("light", toy.throw, {}, 0.0), "`weight` must be positive, got 0"),
    ],
)
def test_parts_are_checked(part, message, monkeypatch):
    parts = [*toy.parts(QUICK), part]
    monkeypatch.setattr(toy, "parts", lambda settings: parts)
    with pytest.raises(ValueError, match=message):
        papers.list_parts(toy, QUICK)


ROW = Row("T", "r", "q", 1.0, 1.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: [replace(ROW, ours=float("nan"))], "row T, r, q: `ours`"),
        (lambda: [replace(ROW, ours=True)], "got True"),
        (lambda: [replace(ROW, band=Band(2.0, 1.0, toy.NEAR))], "band is empty"),
        (lambda: [ROW, ROW], "twice"),
        (lambda: Band(None, None, toy.NEAR), "`low` or `high`"),
        (lambda: Origin("guess", "A guess."), "valid: bound, independent, tolerance"),
        (lambda: Origin("bound", " "), "where it comes from"),
    ],
)
def test_rows_and_bands_are_checked(make, message):
    with pytest.raises(ValueError, match=message):
        check_rows(make())


@pytest.mark.parametrize(
    ("low", "high", "paper", "ours", "printed_inside"),
    [
        (1.0, 2.0, 1.0, 2.0, True),
        (1.0, 2.0, 1.5, 2.1, False),
        (1.0, 2.0, 1.5, 0.9, False),
        (1.0, 2.0, 2.5, 1.5, False),  # the band excludes the printed value, and holds ours
        (1.0, 2.0, 1.5, None, False),
        (1.0, 2.0, None, 1.5, None),
        (None, 2.0, -9.0, 2.0, True),
        (None, 2.0, -9.0, 2.1, False),
        (2.0, None, 9.0, 2.0, True),
        (2.0, None, 9.0, 1.9, False),
        (0.0, 0.0, 0.0, 0.0, True),
        (0.0, 0.0, 0.0, 0.1, False),
    ],
)
def test_the_printed_value_and_ours_both_have_to_lie_in_the_band(
    low, high, paper, ours, printed_inside
):
    row = replace(ROW, paper=paper, ours=ours)
    assert (row.printed_inside, row.agrees, row.kept) == (None,) * 3
    mine = printed_inside is not False or paper == 2.5
    for origin in (toy.NEAR, toy.SECOND, toy.SIDES):
        held = replace(row, band=Band(low, high, origin))
        assert held.band.holds(ours) is mine
        assert held.printed_inside is printed_inside
        assert held.agrees is (mine if origin is toy.SECOND else None)
        assert held.kept is (mine if origin is toy.SIDES else None)


def test_rows_come_back_from_their_record():
    made = [
        Row("T", "r", "a", 1.0, 1.5, Band(1.0, None, toy.NEAR), "a note"),
        Row("T", "r", "b", None, 1.5, Band(None, 2.0, toy.SECOND)),
        Row("T", "r", "c", None, None),
    ]
    rows = fill_origins(made, seed=4)
    assert rows[0].band.origin.text == "Half an eye to either side; seed 4."
    assert rows_from_record(json.loads(json.dumps(rows_record(rows)))) == rows
    assert [format_letter(n) for n in (0, 25, 26, 51, 52)] == ["A", "Z", "AA", "AZ", "BA"]


def test_texts_and_comments_cost_no_run_but_code_does(tmp_path, monkeypatch):
    monkeypatch.setattr(sources, "ROOT", tmp_path)
    package = tmp_path / "toys" / "toy2025"
    package.mkdir(parents=True)

    def digest(name, text):
        package.joinpath(f"{name}.py").write_text(text)
        return sources.digest_of_modules({"toys.toy2025.runs"})

    digest("draws", "SIDES = 6\n")
    digest("helper", "from .draws import SIDES\n")
    digest("__init__", "from .runs import play\n")
    begin = '"""A paper."""\ndef play():\n    from . import helper\n'
    first = digest("runs", f'{begin}FINDINGS = "a"\nRUNS = 3\ndef rows(): return 1\n')
    changed = begin.replace("A paper", "Paper") + "# told\n"
    assert digest("runs", f'{changed}FINDINGS = "b"\nRUNS = 3\ndef rows(): return 2\n') == first
    # what the computing module does not import counts for nothing
    assert digest("words", "RUNS = 4\n") == first
    assert digest("__init__", "RUNS = 4\n") == first
    assert digest("draws", "SIDES = 5\n") != first
    assert digest("draws", "SIDES = 6\n") == first
    assert digest("runs", f'{begin}FINDINGS = "b"\nRUNS = 4\n') != first
    other = digest("runs", begin.replace("helper", "helper, RUNS"))
    assert digest("__init__", "RUNS = 5\n") != other
