r"""What the best possible test can do, as a function of the deflection or of the divergence.

A known attack shifts the clairvoyant statistic, normal with variance 1, by the deflection d:

.. math:: P_D = Q(Q^{-1}(P_{FA}) - d)

A test that knows the attack but for its heading has a chi-square statistic with two degrees of
freedom and the noncentrality d^2.  For any attack at all, with D the divergence (in nats) of the
attacked from the clean measurements, no test exceeds the :math:`P_D` at which

.. math:: \mathrm{kl}(P_D, P_{FA}) = P_D \ln\frac{P_D}{P_{FA}}
    + (1 - P_D) \ln\frac{1 - P_D}{1 - P_{FA}} = D

and a shift by d of normal measurements has :math:`D = d^2 / 2`.
"""

from __future__ import annotations

from collections.abc import Sequence

from scipy import special, stats
from scipy.optimize import brentq

from ..core.declared import check_number, check_word

LEAST_DEFLECTION = 1e-9
"""Below it the square is lost in rounding, and SciPy's noncentral chi-square fails."""


def power(deflection: float, p_fa: float, *, heading: str = "known") -> float:
    """Probability that the best possible test finds an attack.

    Parameters
    ----------
    deflection : float
        d, at least 0.
    p_fa : float
        Probability of a false alarm, in (0, 1).
    heading : {"known", "unknown"}
        Whether the test knows the attack exactly, or all of it but its heading.

    Returns
    -------
    float
        P_D.

    Examples
    --------
    >>> from spoofgym.limits import power
    >>> round(power(2.0, 0.05), 2)
    0.64
    """
    check_number("deflection", deflection, least=0.0)
    check_number("p_fa", p_fa, above=0.0, below=1.0)
    check_word("heading", heading, ("known", "unknown"))
    if heading == "known":
        return float(special.ndtr(deflection + special.ndtri(p_fa)))
    if deflection < LEAST_DEFLECTION:
        return p_fa
    threshold = special.chdtri(2.0, p_fa)
    return float(stats.ncx2.sf(threshold, 2, deflection**2))


def deflection_for(p_fa: float, p_d: float, *, heading: str = "known") -> float:
    """Deflection at which the best possible test finds an attack with some probability.

    Parameters
    ----------
    p_fa, p_d : float
        Probabilities of a false alarm and of detection, in (0, 1), the second at least the first.
    heading : {"known", "unknown"}
        Whether the test knows the attack exactly, or all of it but its heading.

    Returns
    -------
    float
        d.

    Examples
    --------
    >>> from spoofgym.limits import deflection_for
    >>> round(deflection_for(0.01, 0.06), 2)
    0.77
    >>> round(deflection_for(0.01, 0.06, heading="unknown"), 2)
    1.22
    """
    check_number("p_fa", p_fa, above=0.0, below=1.0)
    check_number("p_d", p_d, above=0.0, below=1.0)
    check_word("heading", heading, ("known", "unknown"))
    if p_d < p_fa:
        raise ValueError(f"`p_d` must be at least `p_fa` = {p_fa}, got {p_d}")
    if heading == "known":
        return float(special.ndtri(p_d) - special.ndtri(p_fa))
    if p_d == p_fa:
        return 0.0
    high = 1.0
    while power(high, p_fa, heading=heading) < p_d:
        high *= 2.0
    found = brentq(lambda d: power(d, p_fa, heading=heading) - p_d, 0.0, high, xtol=1e-10)
    return float(found)


def compute_kl_divergence(p_d: float, p_fa: float) -> float:
    return float(special.rel_entr(p_d, p_fa) + special.rel_entr(1.0 - p_d, 1.0 - p_fa))


MEASURED = ("blind", "tracking")
"""Knowledge that is of no error of the victim, whatever is observed."""


def check_no_latent(knowledge: str, latent_names: Sequence[str] | None = None) -> None:
    """Raise where the bound by divergence does not hold for what a spoofer observes. An "oracle"
    may see the error of the estimate, and is refused unless it is known to observe none of it
    (`Observer.latent_names`). The victim's reports always have that error."""
    none_latent = latent_names is not None and not latent_names
    if knowledge in MEASURED or (knowledge == "oracle" and none_latent):
        return
    seen = f", which observes {', '.join(latent_names)}" if latent_names else ""
    raise ValueError(
        f"there is no bound by divergence for a spoofer with the knowledge {knowledge!r}{seen}: it "
        "may see an error that no measurement shows, so its commands are not a function of past "
        "measurements, and their divergence is not d^2 / 2"
    )
