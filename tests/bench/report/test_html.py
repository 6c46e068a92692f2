"""Reports as one HTML file: what it shows, that it loads nothing, and how a browser plays it."""

import html
import json
import re
import shutil
import subprocess
import sys
import warnings

import numpy as np
import pytest

from spoofgym.bench import CampaignResults, run_campaign, summarize
from spoofgym.bench.experiments import Store
from spoofgym.bench.experiments.store import OUTPUTS, Cell, Result
from spoofgym.bench.report.campaign_page import build_page, choose_worst_run, replay_worst
from spoofgym.bench.report.detector_page import build_scores_page, load_families
from spoofgym.bench.report.figures import Line, draw_heat, draw_lines, render_svg
from spoofgym.bench.report.game_page import build_game_page
from spoofgym.bench.report.page import MOST_BYTES, load_replay, render_page, write_page
from spoofgym.bench.runs.record import MEASURES, Aim, Protection, RunRecord, Winner
from spoofgym.bench.scores.detector import DetectorScore
from spoofgym.core.plots import figure_class
from spoofgym.detectors import DETECTORS, Ewma
from spoofgym.tasks import DETECTOR_TASKS

from ..support import RAMP, small_suite

NAME = "<script>alert(1)</script>"
POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="module")
def suite():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(DETECTORS, NAME, type("Scripted", (Ewma,), {"__doc__": "Scripted."}))
        yield small_suite(detectors=(NAME, "never"), spoofers=("step", RAMP), notes=(NAME, "a$b$"))


@pytest.fixture(scope="module")
def results(suite, tmp_path_factory):
    results = run_campaign(suite, tmp_path_factory.mktemp("html"), threads=1)
    replay_worst(suite, results, summarize(results))
    return results


def render(results):
    return render_page(build_page(results, summarize(results), load_replay(results.store)))


@pytest.fixture(scope="module")
def page(results):
    return render(results)


def embedded(text, name):
    (found,) = re.findall(f'<script type="application/json" id="{name}">(.*?)</script>', text)
    return json.loads(found)


def test_a_page_loads_nothing_and_its_bytes_follow_from_the_results(results, page):
    assert f'http-equiv="Content-Security-Policy" content="{POLICY}"' in page
    assert not re.findall(r"https?://|\bsrc=|@import|url\((?!#)|xmlns", page)
    assert len(page.encode()) < 500_000 < MOST_BYTES < 2_000_000
    assert render(CampaignResults.load(results.path)) == page
    for title in (
        "Undetected displacement",
        "Displacement against time",
        "P(HMI) against alert limit",
        "A run of the worst attack, played again",
        "What was run",
        "Terms",
    ):
        assert title in page
    assert page.count("<svg") > 6
    assert results.store.config["code"]["sources"] in page
    assert "<dt>Kaplan-Meier</dt>" in page
    assert "<dt>P(HMI)</dt>" in page
    assert "<dt>payoff</dt>" not in page  # a term of games


def test_a_name_is_text_wherever_it_stands(results, page):
    assert NAME not in page
    assert page.count(html.escape(NAME)) > 5
    assert embedded(page, "scores") == summarize(results)
    assert embedded(page, "run") == load_replay(results.store)


def test_the_replay_is_the_run_in_which_the_worst_attack_gets_farthest(suite, results):
    summary, replay = summarize(results), load_replay(results.store)
    label, spoofer, _, run = choose_worst_run(results, summary)
    assert label == NAME
    assert replay["title"] == f"{spoofer} against {NAME}, run {run}"
    stored = results.runs(label, spoofer).displacement_m
    assert replay["undetected_m"] == pytest.approx(stored[run], abs=1e-4)
    assert stored[run] == stored[results.runs(label, spoofer).counts].max()
    count = len(replay["time"])
    assert count == suite.world.setup.steps + suite.world.setup.hold
    assert replay["attack_s"] == suite.world.setup.steps * suite.world.setup.interval_s
    assert {len(replay[name]) for name in ("north", "off", "error", "ratio", "twin")} == {count}
    assert all(0 <= state <= 2 for *_, state in replay["sky"][0])


def test_a_half_finished_folder_and_one_without_matplotlib_have_a_page(
    results, tmp_path, monkeypatch
):
    shutil.copytree(results.path, tmp_path / "half")
    half = CampaignResults.load(tmp_path / "half")
    for spoofer in ("step", "ramp(tuned)"):
        half.store.build_path(f"{NAME} / {spoofer} / runs").unlink()
    text = render(half)
    name = html.escape(NAME)
    assert f"<b>Not finished</b>: {name} / step, {name} / ramp(tuned)." in text
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    bare = render(results)
    assert "No drawings: pictures need matplotlib" in bare
    assert "<figure>" not in bare
    assert "<table>" in bare


def scored(detector, family, held_out):
    rng = np.random.default_rng([len(detector), len(family)])
    moved, spec = rng.gamma(2.0, 10.0, 60), {"name": "ramp", "rate_mps": 0.2}
    aims = (Aim(MEASURES[0], limit_m=20.0),)
    winner = Winner("a", "ramp", "rate_mps", 0.2, spec, aims, {MEASURES[0]: moved})
    counts = np.ones(60, dtype=bool)
    return Protection({"detector": detector}, (winner,), counts, np.arange(60), None)


def test_families_of_attacks_have_a_page_finished_or_not(tmp_path):
    store, sizes = Store(tmp_path), {"runs": [60, 0], "selection": {"runs": 8}}
    store.open("protect", {"task": "D1", "alert_limit_m": 20.0})
    for family, held_out in (("ramps", False), ("quiet", True)):
        named = {"family": {"key": family, "held_out": held_out}, **sizes}
        store.put(Cell(f"{family} {NAME}", named), Result(*scored(NAME, family, held_out).parts()))
    text = render_page(build_scores_page(store))
    assert f"<b>Not finished</b>: {html.escape(NAME)} / profiles, " in text
    assert "<p>There are no scores yet" in text
    (families,) = load_families(store).values()
    alarms = {"clean, judged window": np.zeros(60, dtype=bool)}
    alarms |= dict.fromkeys(("clock_step", "satellite_loss", "front"), np.ones(60, dtype=bool))
    score = DetectorScore("D1", NAME, 20.0, 60, 8, 0, tuple(families), alarms, 160.0)
    scores = {"detectors": [{**score.as_dict(), "warnings": ["blind after 10 min"]}]}
    files = write_page(store, build_scores_page(store, scores))
    assert [file.name for file in files] == [*OUTPUTS[:2]]
    text = files[1].read_text()
    assert "Not finished" not in text
    assert "<button>detector</button>" not in text  # there is one, which the title names
    floored = {**scores["detectors"][0], "floor_m": {"half": {"value": 7.0}}}
    drawn = build_scores_page(store, {"detectors": [floored]}).pictures
    axes = figure_class()().subplots()
    next(each for each in drawn if "by family" in each.title).draw(axes)
    marks = [line.get_ydata().mean() for line in axes.lines if set(line.get_xdata()) == {7.0}]
    (row,) = (text.get_position()[1] for text in axes.texts if text.get_text().startswith("ramps"))
    assert marks == pytest.approx([row + 0.36])  # quiet signals are another attack
    half = Protection.parts(scored("half", "ramps", False))
    named = {"family": {"key": "ramps", "held_out": False}, **sizes}
    store.put(Cell("ramps half", named), Result(*half))
    assert [*build_scores_page(store, scores).missing] == ["half / quiet"]
    verdict = " ".join(re.sub("<.*?>", "", each) for each in re.findall("<p>(.*)</p>", text))
    assert "Warning: blind after 10 min. False alarms: 0.0 (0.0 to " in verdict
    for each in (DETECTOR_TASKS["D1"].family(key) for key in ("ramps", "quiet")):
        first = text[re.search(rf"\b{each.key}\b", text).start() :]
        star = "*" * each.held_out
        assert first.startswith((f"{each.key} ({each.title}) ", f"{each.key}{star}: {each.title}"))
    assert NAME not in text


def test_a_map_of_shares_has_a_cell_for_each_and_shows_what_is_missing():
    rows, columns = ["ramp", "$a_very$ long name of a spoofer with settings"], ["ewma", NAME]
    text = render_svg(draw_heat(rows, columns, [[0.0, 0.123], [1.0, None]]), 2.0)
    shown = re.findall(r"<text[^>]*>([^<]*)</text>", text)
    assert [x for x in shown if re.fullmatch(r"\d+|-", x)] == ["0", "12", "100", "-"]
    assert {"ramp", "$a_very$ long name of a spoofe ...", "a: ewma"} <= {*shown}
    assert f"b: {html.escape(NAME, quote=False)}" in shown
    shades = re.findall(r"opacity: ([\d.]+)", text)
    assert sorted(map(float, shades)) == pytest.approx([0.0, 0.0861, 0.7])
    wide = render_svg(draw_heat(["ramp"], [f"d{k}" for k in range(54)], [[0.5] * 54]), 9.0)
    assert {"a: d0", "z: d25", "aa: d26", "az: d51", "ba: d52", "bb: d53"} <= {
        *re.findall(r"<text[^>]*>([^<]*)</text>", wide)
    }


def test_an_unsolved_game_says_which_pairs_are_missing(tmp_path):
    store = Store(tmp_path)
    store.open("game", {"env": "any"})
    arrays = {"undetected_displacement_m": np.array([1.0, 3.0]), "first_alarm": np.array([0, 4])}
    for spoofer, detector in (("ramp", "ewma"), ("step", "ewma"), ("ramp", "cusum")):
        named = {"spoofer": {"name": spoofer}, "detector": [{"name": detector}]}
        store.put(Cell(f"{spoofer} {detector}", named), Result(*RunRecord({}, arrays).parts()))
    text = render_page(build_game_page(store))
    assert "<b>Not finished</b>: step / cusum." in text
    assert "<td>ramp</td><td>ewma</td><td>2</td><td>2.0</td><td>50.0</td>" in text


PROBE = """<script>
const table = document.querySelector("table"), button = table.querySelector("th button");
const names = () => [...table.tBodies[0].rows].map((row) => row.cells[0].textContent);
const output = () => document.querySelector("output").textContent, found = { names: [names()] };
for (let k = 0; k < 2; k++) { button.click(); found.names.push(names()); }
const slider = document.querySelector("#replay input");
const shown = JSON.parse(run.textContent);
found.first = [shown.error[slider.value], shown.undetected_m];
found.end = output();
slider.value = 0;
slider.dispatchEvent(new Event("input"));
found.start = output();
found.drawn = document.querySelectorAll("#replay svg path").length;
found.requests = performance.getEntriesByType("resource").length;
found.wide = [document.documentElement.scrollWidth, innerWidth];
document.querySelectorAll("details").forEach((each) => { each.open = true; });
const boxes = [...document.querySelectorAll(".scroll")];
found.scrolled = boxes.filter((box) => box.scrollWidth > box.clientWidth).length;
found.paper = getComputedStyle(document.body).backgroundColor;
document.body.innerHTML = "<pre></pre>";
document.querySelector("pre").textContent = JSON.stringify(found);
</script></body>"""


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium is installed (Debian: chromium)")
@pytest.mark.parametrize(("width", "dark"), [(1280, False), (520, True)])
def test_in_a_browser_tables_sort_the_slider_plays_and_no_request_leaves(
    page, width, dark, tmp_path
):
    file = tmp_path / "page.html"
    file.write_text(page.replace("</body>", PROBE))
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr"]
    command += [f"--window-size={width},900", f"--user-data-dir={tmp_path / 'profile'}"]
    command += ["--blink-settings=preferredColorScheme=0"] if dark else []
    command += ["--virtual-time-budget=3000", "--dump-dom", f"file://{file}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert "CONSOLE" not in done.stderr
    found = json.loads(html.unescape(re.search("<pre>(.*)</pre>", done.stdout)[1]))
    first, up, down = found["names"]
    assert first == [NAME, "never"]
    assert (up, down) == (first, first[::-1])
    assert found["first"][0] == pytest.approx(found["first"][1], abs=0.02)
    assert found["start"] != found["end"]
    assert found["start"].startswith("0.5 s: statistic / threshold ")
    assert found["drawn"] > 20
    assert found["requests"] == 0
    assert found["wide"][0] <= found["wide"][1] <= width
    assert width < 1280 or found["scrolled"] == 0
    assert found["paper"] == ("rgb(22, 24, 28)" if dark else "rgb(255, 255, 255)")


def test_curves_that_are_zero_everywhere_are_drawn_on_a_plain_axis(tmp_path):
    figure = figure_class()()
    axes = figure.subplots()
    draw_lines([Line("silent", [0.0, 60.0], [0.0, 0.0])], "time [s]", "found", log="y")(axes)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.savefig(tmp_path / "x.svg")
    assert axes.get_yscale() == "linear"
