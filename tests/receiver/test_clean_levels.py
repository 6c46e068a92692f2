"""What the receiver of the papers' tables believes of its innovations, when nobody attacks."""

import numpy as np
import pytest

from spoofgym.receiver import TightlyCoupled
from spoofgym.truth.scenario import Scenario

from ..clean_runs import begin


@pytest.mark.parametrize("errors", ["white", "groves"])
def test_belief_and_innovations(errors):
    """Innovations by their believed deviations after 200 s at 2 Hz, the beliefs, and NIS a run."""
    runs, epochs = 64, 40
    batch = begin(Scenario(errors=errors), TightlyCoupled(), runs, 300.0)
    batch.run_filter_only(400)
    ratios, nis = [], np.zeros(runs)
    for _ in range(epochs):
        epoch = batch.advance()
        seen = np.tile(epoch.visible[0], 2)
        belief = np.sqrt(epoch.innovation_variance)
        ratios.append((epoch.innovation / belief)[:, seen])
        z, S = epoch.innovation[:, seen], epoch.innovation_cov[:, seen][:, :, seen]
        nis += np.einsum("bi,bi->b", z, np.linalg.solve(S, z[..., None])[..., 0])
        batch.update(None)
    nis /= seen.sum() * epochs
    ranges, rates = (np.sqrt((x**2).mean()) for x in np.split(np.array(ratios), 2, axis=-1))
    range_sd, rate_sd = np.split(belief[0, seen], 2)
    np.testing.assert_allclose(range_sd, 2.7, atol=0.05)
    np.testing.assert_allclose(rate_sd, 0.715, atol=0.005)
    assert rates == pytest.approx(0.03, abs=0.005)
    if errors == "white":
        assert ranges == pytest.approx(0.4, abs=0.05)
        assert nis.mean() == pytest.approx(0.09, abs=0.01)
    else:
        # four of the eight satellites are redundant, so that 64 runs have 256 independent residuals
        # and their root mean square a standard error of 4.4 %; 3 m of biases give 0.95
        assert ranges == pytest.approx(0.95, abs=0.95 * 4.0 * 0.044)
        # 0.23 to 1.6 over draws of the biases
        assert 0.23 < np.median(nis) < 1.6
        assert nis.max() > 2.0 * nis.min()
