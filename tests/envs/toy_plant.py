"""A plant of few lines: a vehicle that stands, and believes a part of every fix."""

from __future__ import annotations

import numpy as np

from spoofgym._memory import Memory
from spoofgym.detectors import Detector, DetectorContext, Verdict, make_detector
from spoofgym.detectors.verdicts import judged
from spoofgym.envs.plant import Plant
from spoofgym.envs.plant_env import PlantEnv, PlantVectorEnv
from spoofgym.envs.setup import Timeline
from spoofgym.receiver.epoch import Epoch


class FarFix(Detector):
    """Alarms, and rejects the fix, where it is far from the prediction."""

    paper = "groves2013"
    measures = "position"

    def __init__(self, threshold_m=4.5):
        self.threshold_m = threshold_m

    def bind(self, context):
        super().bind(context)
        self.memory.declare("far", np.zeros(context.receivers))

    def judge(self, epoch):
        apart = np.hypot(epoch.innovation[:, 0], epoch.innovation[:, 1])[:, None]
        alarm = apart > self.threshold_m
        self.memory["far"] = self.memory["far"] + alarm[:, 0]
        weights = np.where(alarm, 0.0, np.ones_like(epoch.innovation))
        return Verdict(apart, np.full_like(apart, self.threshold_m), alarm, weights)


DEFAULT_TIMELINE = Timeline(warmup_s=10.0, live_s=10.0, attack_s=20.0, time_to_alert_s=5.0)


class ToyPlant(Plant):
    kind = "toy"
    action_names = ("north_rate", "east_rate")
    interval_s = 0.5

    def __init__(self, receivers, *, detector=None, timeline=None, rate_mps=2.0, gain=0.3):
        if not rate_mps > 0.0:
            raise ValueError(f"`rate_mps` must be > 0, got {rate_mps}")
        self.receivers, self.rate_mps, self.gain = receivers, rate_mps, gain
        self.unbound = FarFix() if detector is None else make_detector(detector)
        if timeline is None:
            timeline = DEFAULT_TIMELINE
        self.timeline = timeline if isinstance(timeline, Timeline) else Timeline(**timeline)
        _, self.live, self.steps, self.hold = self.timeline.epochs(self.interval_s)
        self.epochs = self.live + self.steps + self.hold + 2  # one more, that a game may run
        self.detector = make_detector(self.unbound)
        self.detector.bind(DetectorContext(receivers, 0, self.interval_s, np.ones(2), ()))
        self.memory = Memory(receivers)
        for name in ("estimate", "offset", "rate"):
            self.memory.declare(name, np.zeros((receivers, 2)))
        self.memory.declare("ratio", np.zeros(receivers))
        self.memory.declare("k", np.zeros(receivers, dtype=np.int64))
        self.memory.declare("noise", np.zeros((receivers, self.epochs, 2)))

    def spawn(self, receivers):
        return type(self)(
            receivers,
            detector=self.unbound,
            timeline=self.timeline,
            rate_mps=self.rate_mps,
            gain=self.gain,
        )

    def begin(self, rngs):
        assert len(rngs) == self.receivers
        self.memory.reset()
        self.detector.reset()
        draws = [rng.spawn(1)[0].standard_normal((self.epochs, 2)) for rng in rngs]
        self.memory["noise"] = np.array(draws)
        alarmed = np.zeros(self.receivers, dtype=np.bool_)
        for _ in range(self.live):
            alarmed |= self.advance(None)
        return alarmed

    def advance(self, action):
        m = self.memory
        if action is not None:
            m["rate"] = self.rate_mps * action
        m["offset"] = m["offset"] + self.interval_s * m["rate"]
        noise = m["noise"][np.arange(self.receivers), m["k"]]
        m["k"] = m["k"] + 1
        verdict = judged(self.detector, self._epoch(noise + m["offset"]))
        weight = np.ones(2) if verdict.weights is None else verdict.weights
        innovation = noise + m["offset"] - m["estimate"]
        m["estimate"] = m["estimate"] + self.gain * weight * innovation
        m["ratio"] = (verdict.statistic / verdict.threshold)[:, 0]
        return verdict.alarm.any(axis=1)

    def _epoch(self, fix):
        b, estimate = self.receivers, self.memory["estimate"]
        empty, vectors = np.zeros((b, 0)), np.zeros((b, 0, 3))
        position = np.hstack([estimate, np.zeros((b, 1))])
        return Epoch(
            time=self.time_s(),
            interval=np.full(b, self.interval_s),
            innovation=fix - estimate,
            innovation_cov=np.tile(np.eye(2), (b, 1, 1)),
            predicted_cov=np.tile(np.eye(2), (b, 1, 1)),
            design=np.tile(np.eye(2), (b, 1, 1)),
            transition=np.tile(np.eye(2), (b, 1, 1)),
            imu_delta=np.zeros((b, 6)),
            pseudorange=empty,
            range_rate=empty,
            satellite_position=vectors,
            satellite_velocity=vectors,
            visible=np.zeros((b, 0), dtype=np.bool_),
            predicted_position=position,
            predicted_velocity=np.zeros((b, 3)),
        )

    def error_ne(self):
        return self.memory["estimate"]

    def time_s(self):
        return self.interval_s * self.memory["k"]

    def observation(self, knowledge):
        names = ["own_offset_north", "own_offset_east", "time_left"]
        low, high = [-10.0, -10.0, 0.0], [10.0, 10.0, 1.0]
        if knowledge != "blind":
            names, low, high = [*names, "target_north"], [*low, -1.0], [*high, 1.0]
        if knowledge == "oracle":
            names, low, high = [*names, "statistic_ratio"], [*low, 0.0], [*high, 10.0]
        return tuple(names), np.array(low), np.array(high)

    def observe(self, knowledge, out):
        out[:, :2] = self.memory["offset"] / 10.0
        out[:, 2] = 1.0 - (self.memory["k"] - self.live) / self.steps
        if knowledge != "blind":
            out[:, 3] = 0.0
        if knowledge == "oracle":
            out[:, 4] = self.memory["ratio"]


class ToyEnv(PlantEnv):
    plant_type = ToyPlant


class ToyVectorEnv(PlantVectorEnv):
    plant_type = ToyPlant
