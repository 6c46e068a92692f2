"""What the best possible test can do: published values, and what must hold of any of them."""

import re
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofgym.envs.factory import make_setup
from spoofgym.envs.observer import Observer
from spoofgym.envs.terms.observation import (
    KNOWLEDGE,
    OBSERVATION_TERMS,
    StatisticRatio,
    default_terms,
)
from spoofgym.limits import deflection_for, power
from spoofgym.limits.power import check_no_latent, compute_kl_divergence
from spoofgym.simulation import TightlyCoupledSetup

PART = st.floats(1e-6, 0.999)
HEADING = st.sampled_from(["known", "unknown"])


@pytest.mark.parametrize(
    ("p_fa", "p_d", "heading", "d"),
    [
        (0.01, 0.06, "known", 0.77),
        (0.05, 0.10, "known", 0.36),
        (0.01, 0.06, "unknown", 1.22),
        (0.01, 0.5, "unknown", 2.86),
        (0.01, 0.999, "unknown", 6.01),
    ],
)
def test_deflections_of_the_theory(p_fa, p_d, heading, d):
    assert deflection_for(p_fa, p_d, heading=heading) == pytest.approx(d, abs=0.005)


@pytest.mark.parametrize(("p_fa", "known", "any_test"), [(0.05, 0.64, 0.82), (0.01, 0.37, 0.58)])
def test_powers_of_the_theory_at_two_nats(p_fa, known, any_test):
    assert power(2.0, p_fa) == pytest.approx(known, abs=0.005)
    low, high = (compute_kl_divergence(any_test + each, p_fa) for each in (-0.005, 0.005))
    assert low < 2.0 < high


@given(p_fa=PART, d=st.floats(0.0, 20.0), more=st.floats(0.0, 5.0), heading=HEADING)
def test_power_grows_with_deflection_and_false_alarms_within_its_bounds(p_fa, d, more, heading):
    low = power(d, p_fa, heading=heading)
    assert p_fa - 1e-9 <= low <= power(d + more, p_fa, heading=heading) + 1e-9
    assert low <= power(d, 0.5 * (1.0 + p_fa), heading=heading) + 1e-9
    # knowing less never helps, and no test beats the divergence
    assert low <= power(d, p_fa) + 1e-9
    if d < 8.0:
        assert compute_kl_divergence(power(d, p_fa), p_fa) <= 0.5 * d * d + 1e-9


@given(p_fa=PART, p_d=PART, heading=HEADING)
def test_power_and_deflection_are_inverse(p_fa, p_d, heading):
    p_fa, p_d = sorted((p_fa, p_d))
    d = deflection_for(p_fa, p_d, heading=heading)
    assert d >= 0.0
    assert power(d, p_fa, heading=heading) == pytest.approx(p_d, abs=1e-7)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: power(-1.0, 0.1), "`deflection` must be a number of at least 0, got -1.0"),
        (lambda: power(1.0, 0.0), "`p_fa` must be a number above 0 and below 1, got 0.0"),
        (lambda: power(1.0, 0.1, heading="x"), "`heading` must be 'known' or 'unknown', got 'x'"),
        (lambda: deflection_for(0.1, 1.0), "`p_d` must be a number above 0 and below 1, got 1.0"),
        (lambda: deflection_for(0.1, 0.05), "`p_d` must be at least `p_fa` = 0.1, got 0.05"),
    ],
)
def test_what_is_out_of_range_is_named(call, said):
    with pytest.raises(ValueError, match=f"^{re.escape(said)}$"):
        call()


@pytest.mark.parametrize("knowledge", KNOWLEDGE)
def test_no_bound_by_divergence_for_knowledge_of_a_latent_error(knowledge):
    setup = make_setup(TightlyCoupledSetup, {"detector": "never"})
    latent = Observer(default_terms(setup, knowledge), setup).latent_names
    if knowledge in ("blind", "tracking"):
        assert latent == ()
        check_no_latent(knowledge)
        check_no_latent(knowledge, latent)
        return
    said = re.escape(repr(knowledge))
    for observed in (None, latent):
        with pytest.raises(ValueError, match=f"no bound by divergence .* {said}"):
            check_no_latent(knowledge, observed)


def test_an_oracle_that_sees_statistics_alone_has_the_bound():
    check_no_latent("oracle", ())
    with pytest.raises(ValueError, match="observes error_east, my_own"):
        check_no_latent("oracle", ["error_east", "my_own"])


def test_terms_that_may_hold_an_error_of_the_estimate_are_those_three():
    latent = {name for name, kind in OBSERVATION_TERMS.items() if kind.latent}
    assert latent == {"estimate-error", "reported-position", "reported-deviation"}, (
        "a new term of measurements, commands and the truth alone has `latent = False`; "
        "another is named here"
    )


def test_a_term_that_does_not_say_so_may_hold_one():
    setup = make_setup(TightlyCoupledSetup, {"detector": "ewma"})
    other = SimpleNamespace(
        knowledge="oracle", names=lambda _: ("mine",), bounds=lambda _: (0.0, 1.0)
    )
    assert Observer([StatisticRatio(), other], setup).latent_names == ("mine",)
