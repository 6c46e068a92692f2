"""Where the bands come from."""

from __future__ import annotations

from ..frame import Origin

VARIED = """
    Run i has the errors of its robot from SeedSequence({seed}, spawn_key=(0, i)), its attack from
    (1, i); the course and the error of the heading are the same in all."""
SECOND = """
    It had 200 runs for each of the heading's errors of 2, 4 and 6 deg; its seeds are not recorded;
    they, and with them all noise, varied from run to run, on another course of the same size."""

MEAN = Origin(
    "independent",
    """Mean of a second program with a heading's error of 4 deg, and one standard deviation of its
    single runs to either side. Ours is the mean of {runs} runs with 4 deg."""
    + SECOND
    + VARIED,
)
MEDIAN = Origin(
    "independent",
    """Median of a second program without an attack and with a heading's error of 4 deg, and one
    standard deviation of its single runs to either side. Ours is the median of {runs} runs with 4
    deg."""
    + SECOND
    + VARIED,
)
RANGE = Origin(
    "independent",
    """1 to 99 % of the single runs of a second program. Ours is the median of {runs} runs with a
    heading's error of 4 deg."""
    + SECOND
    + VARIED,
)
SHARE = Origin(
    "independent",
    """At least 90 % of our runs, {runs} for each of the heading's errors of 2, 4 and 6 deg, in what
    are 1 to 99 % of the single runs of a second program; the rest is room for another course."""
    + SECOND
    + VARIED,
)
EVERY = Origin(
    "independent",
    """The value of every single run of a second program. Ours is the median of {runs} runs with a
    heading's error of 4 deg."""
    + SECOND
    + VARIED,
)
ORDER = Origin(
    "independent",
    """Every run: so it was in all 600 of a second program. Ours are {runs} runs for each of the
    heading's errors of 2, 4 and 6 deg."""
    + SECOND
    + VARIED,
)
END = Origin(
    "independent",
    """A second program had RIO locked out at the end of every run, and ACNA in its production form
    in one of a hundred; 5 points for the latter, set by us. Ours is a share of {runs} runs with a
    heading's error of 4 deg."""
    + SECOND
    + VARIED,
)
SWEEP = Origin(
    "independent",
    """The rate of a second program, and 0.005 to either side, set by us; how many runs it had here
    is not recorded, nor are its seeds. Ours is the rate over all fixes of {runs} runs."""
    + VARIED,
)
RETROACTIVE = Origin(
    "tolerance",
    """The printed 100 %, less 0.1 points for the jump and 1 point for the slow change: set by us.
    Ours is the rate over all fixes of {runs} runs."""
    + VARIED,
)
COUNTED = Origin(
    "bound",
    """By counting: of 300 fixes, the first 19 that are attacked have no alarm, which leaves
    281 / 300; 0.002 to either side, set by us. Ours is the rate over all fixes of {runs} runs."""
    + VARIED,
)
APART = Origin(
    "bound",
    """0.3 m, set by us. Ours is the median of {runs} runs for each of the heading's errors of 2, 4
    and 6 deg."""
    + VARIED,
)
ASSUMED = Origin(
    "independent",
    """Wide limits, set by us, around what a second program had: 0.08 for the jump rule and 0.76 for
    the slow rule under white noise, 0.90 without an anchor. How many runs it had here is not
    recorded, nor are its seeds. Ours is a rate over {runs} runs."""
    + VARIED,
)
RAMP_SHARE = Origin(
    "independent",
    "Share of the runs of a second program, and 0.1 to either side. Ours is a share of {runs} runs."
    + SECOND
    + VARIED,
)
RAMP_LATENCY = Origin(
    "independent",
    "Mean of a second program, and 30 % to either side. Ours is the mean of {runs} runs."
    + SECOND
    + VARIED,
)
