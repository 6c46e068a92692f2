"""Shipped spoofers, by their names; the tests hold for an empty zoo too."""

import json

import pytest

from spoofgym.bench import Suite
from spoofgym.bench.runs.players import fitting
from spoofgym.bench.runs.world import PLAIN_ID, World
from spoofgym.envs.spoofer_binding import setup_of_card
from spoofgym.policies.zoo import ZOO_FOLDER, list_shipped, load_card
from spoofgym.spoofers import SPOOFERS, OnnxPolicy, Ramp, make_spoofer
from spoofgym.spoofers.build import resolve_spec

from .policies import write_policy


@pytest.fixture
def zoo(tmp_path, monkeypatch):
    monkeypatch.setattr("spoofgym.policies.zoo.ZOO_FOLDER", tmp_path)
    return write_policy(tmp_path, "ewma-tiny")


def test_a_shipped_name_makes_its_spoofer_and_a_profile_is_its_settings(zoo):
    assert list_shipped() == ("ewma-tiny",)
    policy = make_spoofer("ewma-tiny")
    assert isinstance(policy, OnnxPolicy)
    assert policy.label == "ewma-tiny"
    named = {"name": "onnx-policy", "file": "ewma-tiny"}
    for spec in ({"name": "ewma-tiny"}, named, policy):
        assert make_spoofer(spec) == policy
    assert make_spoofer(str(zoo)).sha256 == policy.sha256
    assert resolve_spec("ewma-tiny") == {**named, "sha256": policy.sha256}
    settings = {"rates_mps": [0.0, 0.2], "heading_deg": 90.0}
    card = json.loads(zoo.with_suffix(".json").read_text())
    card |= {"kind": "profile", "file": None, "observation": None}
    # two of them are told apart, whatever their cards say
    for name, own in (("slow", settings), ("fast", {**settings, "label": "slow"})):
        made = json.dumps({**card, "name": name, "settings": own})
        (zoo.parent / f"{name}.json").write_text(made)
    assert resolve_spec("slow") == {"name": "profile", **settings, "label": "slow"}
    assert [make_spoofer(name).label for name in list_shipped()] == ["ewma-tiny", "fast", "slow"]


def test_what_is_not_shipped_is_left_as_it_is():
    for spec in ("ramp", {"name": "ramp", "rate_mps": 0.1}, "my.module:Class", Ramp(), 3, None):
        assert resolve_spec(spec) is spec
    policy = {"name": "onnx-policy", "file": "a/b.onnx"}
    assert resolve_spec("a/b.onnx") == policy
    assert resolve_spec({"name": "a/b.onnx", "sha256": "0"}) == {**policy, "sha256": "0"}


def test_wrong_names_are_told_the_right_ones(zoo):
    for spec, message in (
        ("ewma-tyni", r"valid: .*ewma-tiny.*did you mean 'ewma-tiny'"),
        ({"name": "ewma-tiny", "rate_mps": 1.0}, "are fixed, got 'rate_mps'"),
        ({"name": "onnx-policy", "file": "other"}, r"the path .* \(ewma-tiny\), got 'other'"),
    ):
        with pytest.raises(ValueError, match=message):
            make_spoofer(spec)
    with pytest.raises(ValueError, match="unknown shipped spoofer or detector 'ramp'; valid: e"):
        load_card("ramp")
    with pytest.raises(TypeError, match="a spoofer is a name"):
        make_spoofer(3)


def test_every_file_of_the_zoo_has_its_card_and_a_name_of_its_own():
    assert not set(list_shipped("spoofer")) & set(SPOOFERS)
    policies = {path.stem for path in ZOO_FOLDER.glob("*.onnx")}
    assert policies == {name for name in list_shipped() if load_card(name).file is not None}


@pytest.mark.parametrize("name", list_shipped("spoofer"))
def test_every_shipped_spoofer_is_whole_and_fits_its_own_world_and_the_default_one(name):
    card, spoofer = load_card(name), make_spoofer(name)
    assert card.name == name == spoofer.label
    assert spoofer.knowledge == card.knowledge.run_time
    assert spoofer.designed_on == card.knowledge.design_time
    assert card.scores
    if card.file is not None:
        assert card.file.name == f"{name}.onnx"
        assert card.file.bytes < 500_000
    for setup in (setup_of_card(card), World(card.env_id).setup):
        names, notes = fitting(setup)
        assert name in names, notes
    assert name in {entry.label for entry in Suite(env=card.env_id).spoofer_players}


def test_a_learned_spoofer_whose_decisions_do_not_fit_is_left_out_with_the_reason():
    suite = Suite(env=PLAIN_ID, timeline={"attack_s": 25.0})
    (note,) = [note for note in suite.left_out if "ewma-ppo" in note]
    assert "attack window of 25 s must hold a whole number of decisions" in note
