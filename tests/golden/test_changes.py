"""Every detector says of a short attack on every victim what it said before."""

import os
import subprocess
import sys

import numpy as np
import pytest

from . import changes


def test_no_detector_judges_otherwise():
    played = {name: changes.play(setup, judge) for name, setup, judge in changes.cases()}
    stored = {
        path.relative_to(changes.FOLDER).with_suffix("").as_posix()
        for path in changes.FOLDER.rglob("*.csv")
    }
    assert stored == set(played), "`python -m tests.golden.changes` writes them"
    for name, rows in played.items():
        np.testing.assert_allclose(changes.read(name), rows, rtol=2e-5, atol=1e-9, err_msg=name)


@pytest.mark.nightly
def test_no_kernel_reads_beyond_an_array_or_writes_into_one_that_it_may_only_read(tmp_path):
    """Compiled with bounds checks, which users' code is without: an IndexError otherwise.

    Read-only arrays have types of their own here, and a kernel that writes into one has none.
    """
    play = (
        "from spoofgym.core import compile\ncompile.unify = lambda kind: kind\n"
        "from tests.golden import changes\nfor _, *pair in changes.cases(): changes.play(*pair)"
    )
    checked = {"NUMBA_BOUNDSCHECK": "1", "SPOOFGYM_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", play], check=True, env={**os.environ, **checked})
