"""Where the bands come from."""

from __future__ import annotations

from ..frame import Origin

OURS = """
    Ours is the mean over {skies} skies of {draws} cases or more each for every number of spoofed
    satellites; subset, displacement and noise vary from case to case, and the chance of sky k is
    seeded [{seed}, k, table]."""
SECOND = """
    It had 9 skies of 3000 to 4000 cases or more for every number of spoofed satellites, each case
    with a displacement of its own; its seeds are not recorded."""
SKY = "The paper's sky is not printed, and its 100 displacements are shared by all subsets."

HYBRIDS = Origin(
    "tolerance",
    """The printed share, 5 points to either side for no hybrids and 2 for others: chosen by us. In
    a second program the first varied by 0.5 to 1.9 points (standard deviation) between skies, and
    by 1.3 with 100 shared displacements. """
    + SKY
    + OURS,
)
CLOCK = Origin(
    "tolerance",
    """The printed share, 2 points to either side: chosen by us, as in table 2. """ + SKY + OURS,
)
SEEDS = Origin(
    "tolerance",
    """The printed share, 1.5, 4, 3.5 and 3 points to either side for S0 to S3: chosen by us. In a
    second program they varied by up to 0.6, 0.8, 1.0 and 0.8 points (standard deviation) between
    skies, and the average of S1 by 1.0 with 100 shared displacements. """
    + SKY
    + OURS,
)
SEARCH_RATES = Origin(
    "tolerance",
    """The printed rate, 3 points to either side, and 5 with 1 or 11 spoofed satellites: chosen by
    us. In a second program they varied by up to 1.0 points (standard deviation) between skies, with
    1 or 11 spoofed by 1.6. """
    + SKY
    + OURS,
)
TRAVERSAL_RATES = Origin(
    "tolerance",
    """The printed rate, 1.5 points to either side: chosen by us. In a second program they varied by
    up to 0.5 points (standard deviation) between skies. """
    + SKY
    + OURS,
)
SEARCH_FITS = Origin(
    "tolerance",
    """The printed number, 3 to either side: chosen by us. In a second program it varied by up to
    1.0 (standard deviation) between skies. Failed cases are not counted. """
    + SKY
    + OURS,
)
TRAVERSAL_FITS = Origin(
    "tolerance",
    """The printed number, 2 % to either side, and 1 with 1 or 11 spoofed satellites: chosen by us;
    ours has one fit more, of all 12 satellites. Failed cases are not counted. """
    + SKY
    + OURS,
)
AVERAGES = Origin(
    "independent",
    """A range around the average of a second program, of 2.7 standard deviations between its skies
    or more to either side, since the skies are others here."""
    + SECOND
    + OURS,
)
TIME = Origin(
    "bound",
    """Set by us: 8 us a call for SRV-RAIM, 80 us for the traversal. Ours is the processor time of
    the machine that ran it, in the fastest sky, weighted over all subsets.""",
)
