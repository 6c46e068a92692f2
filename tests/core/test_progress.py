"""How far a command is, where there is no terminal."""

import pytest

from spoofgym.core import progress


def test_without_a_terminal_each_part_has_a_line_with_the_time_that_is_left(monkeypatch, capsys):
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    now = iter([0.0, 1.0, 20.0, 25.0, 81.0, 90.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(now))
    with progress.show_progress(4.0) as bar:
        for part in ("floor", "floor", "bounds", "bounds", "bounds"):
            bar.advance(0.5, part)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [
        "floor: 25 %, 20 s, some 60 s left",
        "bounds: 50 %, 81 s, some 81 s left",
    ]


def test_the_time_that_is_left_is_not_foretold_from_next_to_nothing(monkeypatch, capsys):
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    now = iter([0.0, 61.0, 122.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(now))
    with progress.show_progress(1000.0) as bar:
        bar.advance(1.0, "search")
        bar.advance(19.0, "search")
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["search: 0 %, 61 s", "search: 2 %, 122 s, some 5978 s left"]


def test_what_ends_soon_prints_nothing(monkeypatch, capsys):
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    with progress.show_progress(1.0) as bar:
        bar.advance(1.0, "all of it")
    assert capsys.readouterr() == ("", "")


def test_a_lost_interrupt_ends_it_without_a_terminal_too(monkeypatch):
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    with (
        pytest.raises(KeyboardInterrupt),
        progress.show_progress(1.0, interrupted=lambda: True) as bar,
    ):
        bar.advance(0.5, "half")
