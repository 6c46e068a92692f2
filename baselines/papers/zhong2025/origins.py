"""Where the bands come from."""

from __future__ import annotations

from ..frame import Origin

VARIED = """
    Run i is seeded [{seed}, i] and has its own IMU noise, clock and white GNSS noise; flight, sky
    and attack are the same in all."""
SECOND = """
    Its seeds are not recorded; they, and with them all noise, varied from run to run. Its true code
    noise was 1 m, and it spoofed a satellite of 29 deg elevation in another sky."""

CHART = Origin(
    "independent",
    """Median of 50 runs of a second program, and one standard deviation of its single runs to
    either side, but one epoch of 0.5 s at least. Ours is the median of {runs} runs."""
    + SECOND
    + VARIED,
)
SHEWHART = Origin(
    "independent",
    """Median of 50 runs of a second program, and one standard deviation of our {runs} single runs
    to either side, one epoch of 0.5 s at least; that of its own is not recorded. Ours is the
    median."""
    + SECOND
    + VARIED,
)
SATELLITES = Origin(
    "independent",
    """Least to largest of the medians that a second program had by spoofing each of eight
    satellites in turn, since the paper does not say which one it spoofs. Ours is the median of
    {runs} runs with S15 spoofed."""
    + SECOND
    + VARIED,
)
ONE_EPOCH = Origin(
    "tolerance",
    """The printed 0.01 s and one epoch of 0.5 s more. Ours is the median of {runs} runs."""
    + VARIED,
)
NEARLY_ALL = Origin(
    "tolerance",
    """All runs or epochs, as the paper claims from one run, or none, but for one in twenty: chosen
    by us. Ours is a share of {runs} runs; in experiments 1 to 5 of {few}."""
    + VARIED,
)
ALL = Origin("tolerance", "Every one of our {runs} runs, as the paper claims from one." + VARIED)
NONE = Origin(
    "tolerance",
    """None, as the paper claims, but for 1 % of the seven satellites that are not spoofed, in
    {runs} runs: chosen by us."""
    + VARIED,
)
FEW = Origin(
    "bound",
    "1 % of the seven satellites that are not spoofed, in {runs} runs: chosen by us." + VARIED,
)
METRIC = Origin(
    "bound",
    """The paper's threshold T3 = 0.6, on the side where the metric has to be. Ours is the median
    of {few} runs."""
    + VARIED,
)
