"""Where the bands come from."""

from __future__ import annotations

from ..frame import Origin

VARIED = """
    Run i is seeded [{seed}, i] and has its own IMU noise, clock, white GNSS noise and, where the
    row does not say *no biases*, constant satellite biases; flight, sky and attack are the same in
    all."""

DELAY = Origin(
    "tolerance",
    """The printed time, 20 % or 1.5 s to either side, whichever is more: chosen by us, since the
    paper shows one run. Ours is the median of {runs} runs."""
    + VARIED,
)
SHARE = Origin(
    "tolerance",
    """The printed share, three standard errors to either side, of the difference between the
    paper's 100 runs and our {runs}; a share of 0 or 100 % gets the error of one run."""
    + VARIED,
)
SINGLE_RUN = Origin(
    "tolerance",
    "5 to 95 % of our {runs} single runs, since the paper shows one run. Ours is their median."
    + VARIED,
)
ANY_SATELLITE = Origin(
    "tolerance",
    """Least to largest share among the eight satellites in view, each attacked alone in {runs}
    runs, and three standard errors beyond, of these runs and of the paper's 100: neither the
    satellite of channel 3 nor the size is printed. Ours is the median of the eight."""
    + VARIED,
)
SAMPLES = Origin(
    "independent",
    """326 to 334 samples, and one to either side: a second program of the rate filter found them
    over alpha from 0.5 to 0.9 and epsilon up to 1e-8. It has no noise, and so no runs or seeds.""",
)
ALL_RUNS = Origin(
    "independent",
    """In all of its 50 runs, whose seeds are not recorded, the oracles of a second program alarmed
    at an attack that was not there, or on the wrong channel. The seeds, and with them all noise,
    varied from run to run. The band is 100 % less three standard errors of {runs} runs and of
    100.""",
)
QUARTER = Origin(
    "bound",
    """A quarter, set by us: a second program had 4.4 m of 27 m to the north without biases, 5.8 m
    of 27 m with them. Ours is a ratio of medians of {runs} runs."""
    + VARIED,
)
NO_ALARM = Origin(
    "bound",
    """No alarm, within three standard errors of one alarm in {runs} and in 100 runs: at a
    false-alarm probability of 4e-6 of an epoch, next to none is due."""
    + VARIED,
)
