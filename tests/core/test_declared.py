from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from spoofgym.core.declared import (
    check_number,
    check_word,
    list_declarations,
    setting,
    settings_record,
)


@settings_record
class Push:
    """A push.

    Notes
    -----
    Of no use.
    """

    rate_mps: float = setting(default=0.5, above=0.0, unit="m/s", help="Rate; forwards.")
    epochs: int = setting(default=3, least=1, most=9, help="Length.")
    windows_s: tuple[float, ...] = setting(
        default=(1.0,), above=0.0, increasing=True, unit="s", help="Lengths of windows."
    )
    limit: float | None = setting(default=None, least=0.0, infinite=True, help="Limit.")
    heading: float | str = setting(default=90.0, one_of=("target",), help="Direction.")
    late: bool = setting(default=False, help="Whether it is late.", omitted=True, kw_only=True)
    other: object = None


class Doubled:
    def __post_init__(self):
        self.rate_mps *= 2


@settings_record
class Twice(Doubled, Push):
    """A push of twice the rate."""

    limit: float | None = setting(default=1.0, least=0.5, help="Another limit.")


@pytest.mark.parametrize(
    ("name", "value", "must"),
    [
        ("rate_mps", 0.0, "a number above 0"),
        *(("epochs", wrong, "a whole number from 1 to 9") for wrong in (0, 1.5, True)),
        *(
            ("windows_s", wrong, "a list of numbers above 0 in increasing order")
            for wrong in ([2, 1], (), 3.0)
        ),
        ("limit", -1, "a number of at least 0 or None"),
        *(("heading", wrong, "a finite number or 'target'") for wrong in ("tarjet", np.inf)),
        ("late", 1, "True or False"),
    ],
)
def test_an_error_says_name_value_and_what_is_valid(name, value, must):
    with pytest.raises(ValueError, match="must be") as raised:
        Push(**{name: value})
    assert str(raised.value).startswith(f"`{name}` must be {must}, got {value!r}")


def test_what_is_valid_is_stored_in_one_form_and_arguments_are_refused_in_one():
    push = Push(np.float64(2.0), 5.0, [1, 2.5], np.inf, "target")
    assert push == Push(2.0, 5, (1, 2.5), np.inf, "target")
    assert [type(push.rate_mps), type(push.epochs), type(push.windows_s)] == [float, int, tuple]
    for windows in (np.array([1.0, 2.5]), [np.float64(1.0), np.float64(2.5)]):
        stored = Push(windows_s=windows).windows_s
        assert stored == (1.0, 2.5)
        assert [*map(type, stored)] == [float, float]
    check_number("runs", 3, least=1, whole=True)
    with pytest.raises(ValueError, match=r"`runs` must be a whole number of at least 1, got 2\.5"):
        check_number("runs", 2.5, least=1, whole=True)
    check_word("side", "spoofer", ("spoofer", "detector"))
    with pytest.raises(ValueError, match="`side` must be 'spoofer' or 'detector', got 'x'"):
        check_word("side", "x", ("spoofer", "detector"))


def test_settings_are_checked_before_what_follows_and_in_subclasses():
    assert Twice(rate_mps=2.0).rate_mps == 4.0
    for name, wrong in (("rate_mps", -1.0), ("limit", 0.0), ("epochs", 10)):
        with pytest.raises(ValueError, match=f"`{name}`"):
            dataclasses.replace(Twice(), **{name: wrong})
    with pytest.raises(ValueError, match="did you mean 'target'"):
        Twice(heading="tarjet")


def test_parameters_are_documented_before_the_sections_that_follow():
    assert Push.__doc__ == (
        "A push.\n\nParameters\n----------\n"
        "rate_mps : float, default 0.5\n    Rate [m/s]; forwards. Valid: a number above 0.\n"
        "epochs : int, default 3\n    Length. Valid: a whole number from 1 to 9.\n"
        "windows_s : tuple[float, ...], default (1.0,)\n"
        "    Lengths of windows [s]. Valid: a list of numbers above 0 in increasing order.\n"
        "limit : float or None, default None\n"
        "    Limit. Valid: a number of at least 0 or None.\n"
        "heading : 'target' or float, default 90.0\n    Direction.\n"
        "late : bool, default False\n    Whether it is late.\n"
        "\nNotes\n-----\nOf no use.\n"
    )
    assert [*list_declarations(Twice)] == [*list_declarations(Push)]
