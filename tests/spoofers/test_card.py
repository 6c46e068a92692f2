"""Cards: what is written is read again, and what is wrong is named."""

import json
from pathlib import Path

import pytest

from spoofgym.policies.card import Card, DetectorCard, SpooferCard, describe_context

from .policies import BLIND, card_fields

SCORE = {
    "detector": "ewma",
    "split": "evaluation",
    "entropy": 0,
    "runs": 500,
    "counted": 410,
    "undetected_displacement_m": 33.0,
    "low": 32.0,
    "high": 34.5,
    "alarm_rate": 0.22,
    "clean_alarm_rate": 0.18,
    "budget": 0.05,
}


def fields(**changes):
    made = card_fields("tiny", b"content", BLIND, "blind", {})
    return json.loads(json.dumps({**made, "scores": [SCORE], **changes}))


def profile(**changes):
    settings = {"rates_mps": [0.0, 0.2], "heading_deg": 90.0}
    made = {"kind": "profile", "observation": None, "file": None, "settings": settings}
    return fields(**{**made, **changes})


def test_a_card_is_read_as_it_was_written_in_either_format(tmp_path):
    path = tmp_path / "a" / "card.json"
    for given in (fields(), profile()):
        card = SpooferCard(**given)
        card.save(path)
        assert SpooferCard.load(path) == card
        assert json.loads(path.read_text()) == given
        before = {key: value for key, value in given.items() if key != "side"}
        path.write_text(json.dumps({**before, "format": 1}))
        assert Card.load(path) == SpooferCard.load(path) == card
        with pytest.raises(ValueError, match="is that of a spoofer, which is no detector policy"):
            DetectorCard.load(path)
    assert [path.name for path in path.parent.iterdir()] == ["card.json"]
    before = {name: value for name, value in SCORE.items() if name != "counted"}
    assert SpooferCard(**fields(scores=[before])).scores[0].counted is None


def _other(path, value):
    made = fields()
    *way, last = path.split(".")
    part = made
    for key in way:
        part = part[int(key) if isinstance(part, list) else key]
    part[last] = value
    return made


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (fields(name="../tiny"), r"`name`: .*match pattern"),
        (_other("conditions.interval_s", "0.5"), r"`conditions.interval_s`: .*valid number"),
        (_other("file.name", "../../tiny.onnx"), r"`file.name`: .*match pattern"),
        (_other("action.low", [-1.0]), r"`action`: .*of the same length, got 2, 1 and 2"),
        (_other("action.high", [1.0, 2.0]), r"`action`: an action lies within -1 and 1"),
        (_other("observation.names", ["a"] * 6), r"`observation`: `names` must differ"),
        (_other("observation.low", [20.0] * 6), r"`low` of \w+ must be below `high`, got 20"),
        (_other("scores.0.low", 40.0), r"must be within `low` and `high`, got 33.0, 40.0 and 34.5"),
        (fields(scores=[{}]), r"`scores.0.detector`: Field required; `scores.0.split`"),
        (fields(file=None), r"`file` and `observation` of an onnx-policy must not be null"),
        (fields(settings={"heading_deg": 1.0}), r"`settings` of an onnx-policy must be empty"),
        (profile(file=fields()["file"]), r"`file` of a profile must be null"),
    ],
)
def test_what_is_wrong_is_named(made, message, tmp_path):
    path = tmp_path / "tiny.json"
    path.write_text(json.dumps(made))
    with pytest.raises(ValueError, match=message) as caught:
        SpooferCard.load(path)
    assert str(caught.value).startswith(f"card {path}: ")
    with pytest.raises(ValueError, match=r"there is no card .*nothing\.json"):
        SpooferCard.load(tmp_path / "nothing.json")


def test_what_is_no_json_is_not_written_and_what_is_no_card_not_read(tmp_path):
    for value in (float("nan"), Path("a")):
        card = SpooferCard(**fields()).model_copy(update={"training": {"x": value}})
        with pytest.raises(ValueError, match="card of 'tiny' can't be written"):
            card.save(tmp_path / "tiny.json")
    assert list(tmp_path.iterdir()) == []
    path = tmp_path / "tiny.json"
    for text, message in (
        ('{"training": {"loss": NaN}}', "is not JSON: NaN is no number"),
        ("[1, 2]", "Input should be an object"),
        ("\udcff", "is not JSON: .*decode"),
    ):
        path.write_bytes(text.encode(errors="surrogateescape"))
        with pytest.raises(ValueError, match=message) as caught:
            SpooferCard.load(path)
        assert str(path) in str(caught.value)
    for made in ({"side": "referee"}, {"kind": "profile", "format": 2}, {}):
        path.write_text(json.dumps(made))
        with pytest.raises(ValueError, match=r"`side` must be one of spoofer, detector, got"):
            Card.load(path)


@pytest.mark.parametrize(
    ("changes", "lines"),
    [
        ({"receivers": 5}, []),
        ({"interval_s": 1.0}, ["conditions.interval_s: 0.5 on the card, 1.0 here"]),
        (
            {"steps": 7, "rate_limit_mps": 2.0},
            ["conditions.steps: 30 on the card, 7 here",
             "conditions.rate_limit_mps: 5.0 on the card, 2.0 here"],
        ),
        ({"action_names": ("east_acceleration",)}, ["action: north_acceleration only on the card"]),
        (
            {"action_names": ("east_acceleration", "north_acceleration")},
            ["action: the same names in another order"],
        ),
        (
            {"observation_names": ("time_left", "surprise")},
            ["observation: own_displacement_north, own_displacement_east, own_rate_north, "
             "own_rate_east, ... only on the card", "observation: surprise only here"],
        ),
    ],
)  # fmt: skip
def test_differences_are_told(changes, lines):
    assert SpooferCard(**fields()).diff_context(BLIND._replace(**changes)) == lines
    wider = BLIND._replace(observation_high=(200.0, *BLIND.observation_high[1:]))
    (line,) = SpooferCard(**fields()).diff_context(wider)
    assert line.startswith("observation.high: [100.0, ")
    assert SpooferCard(**profile()).diff_context(wider) == []  # which looks at nothing


def test_by_rate_the_limit_of_the_acceleration_does_not_matter():
    by_rate = BLIND._replace(control="rate", action_names=("north_rate", "east_rate"))
    card = SpooferCard(**fields(**json.loads(json.dumps(describe_context(by_rate)))))
    assert card.diff_context(by_rate._replace(acceleration_limit_mps2=0.01)) == []
    stronger = BLIND._replace(acceleration_limit_mps2=1.0)
    assert len(SpooferCard(**fields()).diff_context(stronger)) == 1
