"""A paper that throws dice."""

import os
from pathlib import Path

import numpy as np

from baselines.papers.frame import Band, Origin, Part, Row, fill_origins

TITLE = "Dice et al. (2025)"
CLAIMS = "The mean of a die is 3.5."
FINDINGS = "It is."
READINGS = "Six sides."
KEY = "toy2025"
NEAR = Origin("tolerance", "Half an eye to either side; seed {seed}.")
SECOND = Origin("independent", "Another die.")
SIDES = Origin("bound", "A die has six sides.")

marks = None


def throw(runs, seed, marks=None):
    """Throw a die; leave a mark, so that a test can count."""
    if marks is not None:
        with Path(marks).open("a") as file:
            file.write(f"{runs}\n")
    eyes = np.random.default_rng([seed, runs]).integers(1, 7, runs)
    return {"eyes": eyes, "mean": eyes.mean(), "ends": [np.int64(eyes.min()), int(eyes.max())]}


def place(seed):
    return {"process": os.getpid(), "threads": os.environ.get("OMP_NUM_THREADS")}


def fail(seed):
    raise ZeroDivisionError("no die")


def parts(settings):
    counts = (100, 200) if settings.quick else (1000, 2000)
    return [
        Part(f"{runs} throws", throw, {"runs": runs, "seed": settings.seed, "marks": marks}, runs)
        for runs in counts
    ]


def rows(data, settings):
    made = [
        Row("Table 1", name, "mean", 3.5, result["mean"], Band(3.0, 4.0, NEAR))
        for name, result in data.items()
    ]
    sizes = sum(len(result["eyes"]) for result in data.values())
    made += [
        Row("Table 2", "all", "throws | all", None, sizes, note="not printed"),
        Row("Table 2", "all", "impossible", 7.0, 0.0, Band(6.5, 7.5, NEAR), "a finding"),
        Row("Table 2", "all", "excluded", 7.0, 3.5, Band(3.0, 4.0, SECOND), "not the paper's"),
        Row("Table 2", "all", "largest", None, 6.0, Band(None, 6.0, SIDES)),
    ]
    return fill_origins(made, seed=settings.seed)


def figures(data, folder):
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots()
    axes.hist(next(iter(data.values()))["eyes"])
    path = folder / "dice_7.png"
    figure.savefig(path)
    plt.close(figure)
    return [path]
