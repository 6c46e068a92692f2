"""The price of an alarm, which follows the budget."""

from types import SimpleNamespace

import pytest

from agents.learning import LEAST, MOST, next_price, set_price


@pytest.mark.parametrize(
    ("price", "amplitude", "gain", "expected"),
    [
        (2.0, 1.0, 1.5, 2.0),
        (2.0, 0.81, 0.5, 2.0 / 0.9),
        (3.0, 0.1, 1.5, 6.0),
        (4.0, 10.0, 1.5, 2.0),
        (7.0, 0.1, 1.5, MOST),
        (1.5, 10.0, 1.5, LEAST),
        (4.0, 0.0, 1.5, MOST),
        (60.0, 0.1, 0.0, 60.0),
    ],
)
def test_it_rises_where_a_policy_had_to_be_scaled_down(price, amplitude, gain, expected):
    assert next_price(price, amplitude, gain) == pytest.approx(expected, rel=1e-12)


def test_it_is_in_lengths_of_the_environment_and_leaves_a_reward_of_ones_own_alone():
    given = []
    for reward in (None, "displacement-gain"):
        core = SimpleNamespace(settings={"reward": reward}, length_m=20.0)
        set_price(SimpleNamespace(core=core, set_rewards=given.append), 3.0)
    (terms,) = given
    assert [term.penalty_m for term in terms if term.name == "alarm"] == [60.0]
