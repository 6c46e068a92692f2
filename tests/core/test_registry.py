"""Objects by name: what is right is built, what is wrong is told with what would be right."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from spoofgym.core.registry import build, build_record, check_choice, check_keywords


@dataclass
class Square:
    side: float = 1.0
    tags: list = field(default_factory=list)


@dataclass
class Circle(Square):
    radius: float = 1.0


@dataclass
class Grid:
    cells: int = 3
    wrap: bool = False
    spacing: float | None = None


def make(spec, word="shape", **more):
    return build(word, {"square": Square, "circle": Circle}, Square, spec, **more)


def test_by_name_by_settings_and_as_a_copy():
    spec = {"name": "circle", "radius": 3.0}
    for _ in range(2):  # it is left alone
        assert make(spec) == Circle(radius=3.0)
    assert make("square") == make({"name": "square"}) == Square()
    mine = Square(2.0, ["a"])
    copied = make(mine)
    assert copied == mine
    copied.tags.append("b")
    assert mine.tags == ["a"]


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("circel", r"^unknown shape 'circel'; valid: circle, square; did you mean 'circle'\?$"),
        ("xyz", "^unknown shape 'xyz'; valid: circle, square$"),
        ({"name": "square", "sidee": 1}, "shape 'square' has no setting 'sidee'; valid: side, tag"),
    ],
)
def test_an_unknown_name_or_setting_is_told_with_the_valid_ones(spec, said):
    with pytest.raises(ValueError, match=said):
        make(spec)
    with pytest.raises(ValueError, match="unknown colour 'rad'; valid: blue, red; did you mean"):
        check_choice("colour", "rad", ["red", "blue"])
    check_choice("colour", "red", {"red": 1, "blue": 2})


@pytest.mark.parametrize("spec", [None, 3, Square, {}, {"side": 1.0}, {"name": 3}, ["square"]])
def test_anything_else_is_no_shape(spec):
    with pytest.raises(TypeError, match=r"^a shape is a name \(circle, square\), a dict with"):
        make(spec)
    with pytest.raises(TypeError, match=r"^an end term is .* \(circle, far, square\), a dict"):
        make(spec, "end term", more=("far", "circle"))


def test_a_record_is_made_of_settings_over_defaults_and_unknown_names_are_named():
    assert build_record("grid", Grid, None) == Grid()
    assert build_record("grid", Grid, {"wrap": True}, {"cells": 5}) == Grid(cells=5, wrap=True)
    assert build_record("grid", Grid, {"cells": 4}, {"cells": 5}) == Grid(cells=4)
    own = Grid(cells=7)
    assert build_record("grid", Grid, own, {"cells": 5}) is own
    for wrong in (5, "cells", [("cells", 1)]):
        with pytest.raises(TypeError, match="`grid` must be a dict of settings or an instance of"):
            build_record("grid", Grid, wrong)
    with pytest.raises(ValueError, match="`grid` has no setting 'cell'; valid: cells, wrap, spac"):
        build_record("grid", Grid, {"cell": 1})

    def draw(colour, *, width=1.0, **style):
        """Takes some arguments by name, and some by `style`."""

    check_keywords(draw, ["dash", "colour"], ["dash"])
    with pytest.raises(
        TypeError,
        match=r"^draw got an unexpected keyword argument 'dsh'; valid: colour, dash, width",
    ):
        check_keywords(draw, ["dsh"], ["dash"])
    with pytest.raises(
        TypeError, match=r"^the pen got an unexpected keyword argument 'x'; valid: dash$"
    ):
        check_keywords("the pen", ["x"], ["dash"])
