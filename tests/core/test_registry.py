"""Objects by name: what is right is built, what is wrong is told with what would be right."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from spoofgym.core.registry import build, build_record, check_choice, check_keywords


class Shape:
    pass


@dataclass
class Square(Shape):
    side: float = 1.0
    tags: list = field(default_factory=list)


@dataclass
class Circle(Shape):
    radius: float = 1.0


@dataclass
class Point(Shape):
    pass


@dataclass
class Grid:
    cells: int = 3
    wrap: bool = False
    spacing: float | None = None


KINDS = {"square": Square, "circle": Circle, "point": Point}


def make(spec):
    return build("shape", KINDS, Shape, spec)


def test_by_name_and_by_name_with_settings():
    assert make("square") == Square()
    assert make({"name": "square"}) == Square()
    assert make({"name": "circle", "radius": 3.0}) == Circle(3.0)


def test_the_given_mapping_is_left_alone():
    spec = {"name": "circle", "radius": 3.0}
    make(spec)
    assert spec == {"name": "circle", "radius": 3.0}


def test_an_object_is_copied():
    mine = Square(2.0, ["a"])
    copied = make(mine)
    assert copied == mine
    assert copied is not mine
    copied.tags.append("b")
    assert mine.tags == ["a"]


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        (
            "circel",
            r"unknown shape 'circel'; valid: circle, point, square; did you mean 'circle'\?",
        ),
        ("xyz", r"unknown shape 'xyz'; valid: circle, point, square$"),
        (
            {"name": "square", "sidee": 1},
            "shape 'square' has no setting 'sidee'; valid: side, tags",
        ),
        ({"name": "point", "x": 1}, "shape 'point' has no setting 'x'; valid: none"),
    ],
)
def test_an_unknown_name_or_setting_is_told_with_the_valid_ones(spec, said):
    with pytest.raises(ValueError, match=said):
        make(spec)


@pytest.mark.parametrize("spec", [None, 3, Square, {}, {"side": 1.0}, {"name": 3}, ["square"]])
def test_anything_else_is_no_shape(spec):
    with pytest.raises(
        TypeError, match=r"a shape is a name \(circle, point, square\), a dict with"
    ):
        make(spec)


def test_a_choice_among_the_valid_ones_passes():
    check_choice("colour", "red", {"red": 1, "blue": 2})
    with pytest.raises(ValueError, match="unknown colour 'rad'; valid: blue, red; did you mean"):
        check_choice("colour", "rad", ["red", "blue"])


def test_a_record_is_made_of_settings_over_defaults():
    assert build_record("grid", Grid, None) == Grid()
    assert build_record("grid", Grid, {"wrap": True}, {"cells": 5}) == Grid(cells=5, wrap=True)
    assert build_record("grid", Grid, {"cells": 4}, {"cells": 5}) == Grid(cells=4)
    own = Grid(cells=7)
    assert build_record("grid", Grid, own, {"cells": 5}) is own
    with pytest.raises(ValueError, match="`grid` has no setting 'cell'; valid: cells, wrap, spac"):
        build_record("grid", Grid, {"cell": 1})
    for wrong in (5, "cells", [("cells", 1)]):
        with pytest.raises(TypeError, match="`grid` must be a dict of settings or an instance of"):
            build_record("grid", Grid, wrong)


@pytest.mark.parametrize(
    ("word", "expected"),
    [("attack", "an attack is a name"), ("end term", "an end term"), ("shape", "a shape")],
)
def test_a_message_has_the_right_article_and_every_name_once(word: str, expected: str) -> None:
    with pytest.raises(TypeError, match=rf"^{expected}.*\(circle, far, point, square\), a dict"):
        build(word, KINDS, Shape, 3, more=("far", "circle"))


def test_unknown_keywords_are_named_with_all_valid_ones() -> None:
    def draw(colour: str, *, width: float = 1.0, **style: object) -> None:
        """Takes some arguments by name, and some by `style`."""

    check_keywords(draw, ["dash", "colour"], ["dash"])
    with pytest.raises(TypeError, match=r"^draw has no argument 'dsh'; valid: colour, dash, width"):
        check_keywords(draw, ["dsh"], ["dash"])
    with pytest.raises(TypeError, match=r"^the pen has no argument 'x'; valid: dash$"):
        check_keywords("the pen", ["x"], ["dash"])
