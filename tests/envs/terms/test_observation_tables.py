"""The docstring of the detector's view says what its terms observe, and in which units."""

import re

import gymnasium as gym

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym.detectors.observation import Elapsed, InnovationSd, PredictedMotion
from spoofgym.duel_v0 import DetectorView
from tools.environments_page import read_table


def test_the_table_of_the_detector_s_view_is_what_it_observes():
    one_sky = {"turn_on": "drawn"}  # which is made sooner
    names = gym.make("spoofgym/DetectorView-v0", domain=one_sky).unwrapped.observation_names
    scales = {
        "range_sd": InnovationSd.range_scale_m,
        "rate_sd": InnovationSd.rate_scale_mps,
        "predicted_velocity": PredictedMotion.velocity_scale_mps,
        "specific_force": PredictedMotion.force_scale_mps2,
        "angular_rate": PredictedMotion.rate_scale_rps,
        "elapsed": Elapsed.scale_s,
    }
    next_one = 0
    for index, words, _, scale in read_table(DetectorView):
        first, _, last = index.partition("-")
        word = re.sub(r"_(slotJJ|XXX)$", "", words)
        assert int(first) == next_one
        next_one = int(last or first) + 1
        assert {name.startswith(word) for name in names[int(first) : next_one]} == {True}
        assert float(scale) == scales.get(word, 1.0)
    assert next_one == len(names)
