"""The leaderboards of the page are those of the stored scores."""

from spoofgym.bench.report import tasks
from tools.leaderboard import END, PAGE, START, list_detectors, list_spoofers, shown
from tools.pages import part_between


def test_the_page_has_the_stored_scores_and_says_what_has_none():
    text = part_between(PAGE.read_text(), START, END)
    assert text == f"\n{shown()}"
    assert all(command in text for command in tasks.missing().values())
    assert "\n\n\n" not in text


def test_the_best_of_a_task_stands_first():
    for key in {row["task"] for row in list_detectors()}:
        tightest = [row["0.5"]["value"] for row in list_detectors() if row["task"] == key]
        farthest = [row["score"]["value"] for row in list_spoofers() if row["task"] == key]
        assert tightest == sorted(tightest)
        assert farthest == sorted(farthest, reverse=True)
        assert tightest
        assert farthest
