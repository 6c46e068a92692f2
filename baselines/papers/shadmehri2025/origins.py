"""Where the bands come from."""

from __future__ import annotations

from ..frame import Origin

VARIED = """
    Run i is seeded [{seed}, i] and has its own errors of GNSS, of the inertial sensors and of the
    start; flight and attack are the same in all."""
SECOND = """
    It had 60 to 150 runs for every case, whose seeds are not recorded; they, and with them
    all errors of GNSS and of the inertial sensors, varied from run to run. Its flight is another
    one."""

LATENCY = Origin(
    "independent",
    """Mean latency of a second program, and one standard deviation of its single runs to either
    side, but one epoch of 0.1 s at least. Ours is the median of those of {runs} runs that
    detect."""
    + SECOND
    + VARIED,
)
LATENCY_WIDTH = Origin(
    "independent",
    """Mean latency of a second program, whose spread is not recorded; the width to either side is
    set by us, 0.1 to 0.7 s, after the spread in like cases. Ours is the median of those of {runs}
    runs that detect."""
    + SECOND
    + VARIED,
)
SHARE = Origin(
    "independent",
    """Share of runs that a second program detected, and three standard errors of the difference
    between 100 runs and our {runs} to either side, but 5 points at least."""
    + SECOND
    + VARIED,
)
CAUSAL = Origin(
    "bound",
    """The share that is detected without the present residual in its own covariance, in the same
    {runs} runs: with it, none can be more."""
    + VARIED,
)
CLEAN_RATE = Origin(
    "independent",
    """Alarms per epoch of a second program, over 2.5 and times 2.5, since alarms come in clusters.
    It counted 60,000 to 100,000 epochs of clean runs for windows of 30, 100 and 150; for the others
    and a fixed R the number is not recorded, nor are its seeds, which varied from run to run, and
    with them all errors. Ours are
    {clean} runs of 350 epochs."""
    + VARIED,
)
NO_ALARM = Origin(
    "independent",
    """None in 15,000 to 22,500 epochs of a second program, whose seeds are not recorded: up to
    1e-4, set by us, since alarms come in clusters. Ours are {clean} runs of 350 epochs."""
    + VARIED,
)
BINOMIAL = Origin(
    "tolerance",
    """0 to the 99.99 % quantile of a binomial count at the stated rate of 1e-5, in {clean} runs of
    350 epochs."""
    + VARIED,
)
CLUSTERS = Origin(
    "bound",
    """1e-3, set by us, a hundred times the stated rate: where errors are correlated, the threshold
    for an estimated covariance does not keep that. {clean} runs of 350 epochs."""
    + VARIED,
)
ABSORBED = Origin(
    "independent",
    """In all of its runs the scale of Q ended at 0 in a second program; 95 % of ours, at least,
    of {runs}."""
    + SECOND
    + VARIED,
)
SCATTER = Origin(
    "bound",
    """A thousandfold between quantiles, or a hundredfold growth: set by us, far below what a second
    program had (1e-4 to 2e2, and 7e2 to 7e5). {runs} runs."""
    + VARIED,
)
NEGATIVE = Origin(
    "independent",
    """Half of the least to twice the most that a second program had in a run, 24 to 51 epochs of
    300. Ours is the mean of {runs} runs."""
    + SECOND
    + VARIED,
)
DUTY = Origin(
    "independent",
    """The range that a second program had over the three ramps, 0.19 to 0.26 for w = 100 and 0.04
    to 0.09 for w = 30, over 1.5 and times 1.5. Ours is the mean of {runs} runs."""
    + SECOND
    + VARIED,
)
AFTERWARDS = Origin(
    "bound", "0.1, set by us; a second program had 0.02. Ours is the mean of {runs} runs." + VARIED
)
ERROR = Origin(
    "independent",
    """Mean error of a second program, 40 % to either side, for another flight. Ours is the mean of
    {runs} runs."""
    + SECOND
    + VARIED,
)
