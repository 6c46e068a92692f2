"""Names with settings: text, objects and labels."""

from datetime import date

import numpy as np
import pytest

from spoofgym.attacks import make_attack
from spoofgym.bench.runs.players import (
    ATTACK,
    PlayerSpec,
    specify_detector,
    specify_player,
    specify_policy,
    specify_spoofer,
)
from spoofgym.core.registry import build_spec, load_class, make, parse_spec, slug
from spoofgym.core.settings import compute_digest, describe, diff_settings
from spoofgym.detectors import DETECTORS, Detector, Ewma
from spoofgym.detectors.isolated import isolate
from spoofgym.spoofers import SPOOFERS, Ramp, Scaled, Spoofer, make_spoofer

EWMA = "spoofgym.detectors.charts:Ewma"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ewma", {"name": "ewma"}),
        ("aime:w=[5, 25],b=1.5,c=none", {"name": "aime", "w": [5, 25], "b": 1.5, "c": None}),
        ("ewma:a=1, b=true,c=both", {"name": "ewma", "a": 1, "b": True, "c": "both"}),
        ('{"name": "ewma", "smoothing": 1}', {"name": "ewma", "smoothing": 1}),
        ("my.module:Class:size=3", {"name": "my.module:Class", "size": 3}),
    ],
)
def test_text_becomes_name_and_settings(text, expected):
    assert parse_spec(text) == expected


@pytest.mark.parametrize("text", ['{"smoothing": 1}', "{name: ewma}", "ewma:a=1,b"])
def test_bad_text_is_refused(text):
    with pytest.raises(ValueError, match=r"must have a|is not JSON|is written `name=value`"):
        parse_spec(text)


def test_labels_tell_what_is_not_default_and_only_the_tunable_setting_is_tuned():
    assert specify_detector("ewma").label == specify_detector(Ewma(smoothing=0.1)).label == "ewma"
    entry = specify_detector({"name": "ewma", "weight_scale": None, "smoothing": 0.25})
    assert entry.label == "ewma(smoothing=0.25,weight_scale=none)"
    assert slug(entry.label) == "ewma-smoothing=0.25-weight_scale=none"
    curve = {"name": "profile", "rates_mps": [0.0, 0.1, 0.2, 0.3], "label": None}
    assert specify_spoofer(curve).label == "profile(rates_mps=4 values,label=none)"
    assert specify_spoofer({**curve, "label": "mine"}).label == "mine"
    assert specify_spoofer({"name": "step", "size_m": "tuned"}).tuned == "size_m"
    with pytest.raises(ValueError, match="`heading_deg` of spoofer 'ramp' can't be tuned; tunable"):
        specify_spoofer({"name": "ramp", "heading_deg": "tuned"})
    with pytest.raises(ValueError, match="tunable: nothing"):
        specify_spoofer({"name": "none", "rate_mps": "tuned"})


class Plain(Detector):
    """Not a dataclass, but keeps its settings under their names."""

    paper = "barshalom2001"

    def __init__(self, *, level=2.0):
        self.level = level

    def bind(self, context):
        super().bind(context)

    def judge(self, epoch):
        raise NotImplementedError


class Forgetful(Plain):
    def __init__(self, factor=2.0):
        super().__init__(level=2.0 * factor)


def test_a_class_of_the_user():
    assert load_class(EWMA, Detector) is Ewma
    assert specify_detector({"name": EWMA, "smoothing": 0.5}).spec["name"] == "ewma"
    entry = specify_detector({"name": f"{__name__}:Plain", "level": 3.0})
    assert entry.label == "Plain(level=3)"
    assert specify_detector(isolate(entry.spec)).label == entry.label
    assert specify_detector(isolate({**entry.spec, "level": 4.0})).label == "Plain(level=4)"
    assert make("detector", DETECTORS, Detector, entry.spec).level == 3.0
    with pytest.raises(TypeError, match=r"must keep its settings .* it has no 'factor'"):
        specify_detector(Forgetful())
    with pytest.raises(ValueError, match=r"no module 'nowhere' .*; Python looked in "):
        load_class("nowhere:Thing", Detector)
    with pytest.raises(ValueError, match=r"mapping: {'name': 'its:Thing', 'level': 7}"):
        make("detector", DETECTORS, Detector, "its:Thing:level=7")
    with pytest.raises(ValueError, match="has no 'Ramq'; did you mean 'Ramp'"):
        load_class("spoofgym.spoofers:Ramq", Detector)
    with pytest.raises(ValueError, match=r"must be a class derived from spoofgym\.detectors\.base"):
        load_class("spoofgym.spoofers:Ramp", Detector)
    with pytest.raises(ValueError, match="unexpected keyword argument 'smooth'"):
        make("detector", DETECTORS, Detector, {"name": EWMA, "smooth": 1})


def test_arrays_are_described_by_what_is_in_them_and_settings_of_one_alone_differ():
    one = describe({"x": np.arange(3.0), "day": date(2012, 10, 31), "n": np.int64(4)})
    assert one == describe({"n": 4, "x": np.arange(3.0), "day": date(2012, 10, 31)})
    assert one["x"] != describe(np.arange(3))
    assert compute_digest(one) == compute_digest(dict(reversed(one.items())))
    with pytest.raises(ValueError, match="must be finite"):
        describe(float("nan"))
    with pytest.raises(TypeError, match="can't be written down"):
        describe({1, 2})
    one, other = {"a": 1, "own": {"b": 2}}, {"own": {"b": 2, "c": 3}, "more": [4]}
    expected = [("a", 1, None), ("own.c", None, 3), ("more", None, [4])]
    assert diff_settings(one, other) == expected
    expected = [("own.c", 3, None), ("more", [4], None), ("a", None, 1)]
    assert diff_settings(other, one) == expected


def test_a_player_is_built_from_its_settings_or_is_an_object():
    for thing, word, kinds, base in (
        (Ewma(smoothing=0.3, weight_scale=None), "detector", DETECTORS, Detector),
        (Ramp(rate_mps=0.25), "spoofer", SPOOFERS, Spoofer),
    ):
        assert make(word, kinds, base, build_spec(word, kinds, thing)) == thing
    tuned, given = specify_spoofer({"name": "ramp", "rate_mps": "tuned"}), Ramp(rate_mps=0.3)
    assert tuned.as_config() == {"label": "ramp(tuned)", "spec": tuned.spec}
    assert tuned.build() == Ramp()
    assert make_spoofer(tuned.with_value(0.3)) == given
    alone = specify_policy(given, "fitted")
    assert (alone.spec, alone.tuned, alone.fixed_spec) == (None, "amplitude", given)
    scaled = alone.with_value(2.0)
    assert isinstance(scaled, Scaled)
    assert (scaled.spoofer, scaled.amplitude) == (given, 2.0)
    known = specify_player(given, "spoofer")
    assert known.label == "ramp(rate_mps=0.3)"
    assert PlayerSpec.from_json("spoofer", known.as_json()) == known
    # an antenna stands to the east
    far = PlayerSpec("meaconer", ATTACK, {"name": "meaconer", "antenna_m": "tuned"}, "antenna_m")
    assert make_attack(far.with_value(20.0)).antenna_m == (0.0, 20.0, 0.0)
