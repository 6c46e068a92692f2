"""What is shipped, on the command line: lists, cards, and playing it."""

import html
from pathlib import Path

import pytest

from .bench.support import small_suite, use_zoo, write_zoo
from .command_line import QUICK, SHORT, call, read, refused
from .detectors.learned.files import edit_card, write_guard

pytestmark = pytest.mark.usefixtures("in_tmp_path")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("zoo")
    write_zoo(folder, small_suite())
    return folder


@pytest.fixture
def zoo_folder(written, monkeypatch):
    use_zoo(written, monkeypatch)
    return written


def test_list_shows_what_is_shipped(zoo_folder):
    rows = read("list", "shipped", "--json")["shipped"]
    assert [row["name"] for row in rows] == ["curve", "push", "track"]
    assert (rows[2]["knowledge"], rows[2]["designed_on"]) == ("tracking", "ewma, by hand")
    assert rows[2]["scores"][0]["undetected_displacement_m"] == 12.5
    table = " ".join(call("list").output.split())
    assert "ewma: 12.5 m (11.0 to 14.0), alarms 20.0 % (clean 18.0 %)" in table
    for name in ("push", zoo_folder / "push.onnx", zoo_folder / "push.json"):
        shown = call("list", name).output
        for part in ("python -m by.hand", "40 commands", "12.5 (11.0 to 14.0)", "push.onnx, "):
            assert part in shown
        assert read("list", name, "--json")["name"] == "push"
    assert "rates_mps" in call("list", "curve").output
    wrong = " ".join(refused("list", "pull").split())
    assert "there is no 'pull'; `spoofgym list` shows all names" in wrong
    assert "there is no card nowhere.json" in refused("list", "nowhere.json")


def test_a_card_of_a_detector_is_shown_by_name_and_by_file(tmp_path, monkeypatch):
    use_zoo(tmp_path, monkeypatch)
    file = write_guard(tmp_path)
    edit_card(file, training={"best_pass": 7})
    for name in ("guard", file, file.with_suffix(".json")):
        shown = call("list", name).output
        for part in ("detector-policy", "hidden (4)", "12 slots, epochs of 0.5 s", "best_pass"):
            assert part in shown
        assert read("list", name, "--json")["statistic"] == "receiver"
    Path("damaged.json").write_text('{"kind": "detector-policy"}')
    assert "card damaged.json" in refused("list", "damaged.json")


def test_bench_and_run_take_learned_and_optimised_spoofers(zoo_folder):
    inline = '{"name": "profile", "rates_mps": [0, 0.1, 0.2], "label": "inline"}'
    chosen = ["--spoofer", "push", "--spoofer", inline, "--detector", "ewma"]
    summary = read("bench", *QUICK, *chosen, "--out", "out", "--json")
    assert [cell["spoofer"] for cell in summary["cells"]] == ["none", "push", "inline"]
    assert all(isinstance(cell["within_budget"], bool) for cell in summary["cells"])
    assert all(cell["spoofer_settings"]["amplitude"] > 0.0 for cell in summary["cells"][1:])
    assert "ewma: " in call("report", "out").output
    assert "stealthy attacks" in call("report", "out", "--verbose").output
    for name, *bare in (["push"], [zoo_folder / "track.onnx", "--no-picture"]):
        assert read("run", *SHORT, "--spoofer", name, "--json", *bare)["largest_error_m"] > 0.0
    assert Path("episode.png").is_file()


@pytest.mark.usefixtures("zoo_folder")
def test_shipped_spoofers_that_do_not_fit_are_named(monkeypatch):
    north = [*QUICK, "--out", "out", "--attack", "false-position:axes=n"]
    assert "needs a command to the east" in refused("bench", *north)
    assert "'push' does not fit this attack: " in refused("bench", *north, "--spoofer", "push")
    assert not Path("out").exists()
    monkeypatch.setattr("spoofgym.bench.experiments.suite.DEFAULT_SPOOFERS", ["step"])
    longer = [*QUICK, "--attack-s", "25", "--detector", "ewma", "--out", "longer"]
    result = call("bench", *longer)
    assert result.exit_code == 0, result.output
    note = (
        "shipped spoofer curve is left out: 'curve' does not fit this attack: conditions.steps: 40 "
        "on the card, 50 here; trained in another world, add --set timeline="
    )
    assert note in html.unescape(Path("longer", "report.html").read_text())
