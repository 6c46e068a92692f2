"""Three detectors of one idea: a good one, one whose threshold grows, and one that goes blind."""

import numpy as np

from spoofgym.detectors import Detector, Verdict


class AverageRate(Detector):
    """Alarm where averaged range-rate innovations, less the clock's part, are not zero."""

    paper = "roberts1959"
    scope = "receiver"
    gain, limit = 0.01, 0.015

    def bind(self, context):
        super().bind(context)
        self.interval_s = context.epoch_interval_s
        self.memory.declare("average", np.zeros((context.receivers, context.channels)))
        self.memory.declare("age_s", np.zeros(context.receivers))

    def judge(self, epoch):
        seen, average = epoch.visible, self.memory["average"]
        n = seen.shape[1]
        self.memory["age_s"] += self.interval_s
        rate = epoch.innovation[:, n:] / np.sqrt(epoch.innovation_variance[:, n:])
        rate -= np.where(seen, rate, 0.0).sum(axis=1, keepdims=True) / np.maximum(
            seen.sum(axis=1, keepdims=True), 1
        )
        average += self.gain * (rate - average)
        average[~seen] = 0.0
        statistic = self.look(np.sqrt((average**2).sum(axis=1)), self.memory["age_s"])[:, None]
        threshold = np.broadcast_to(self.raise_threshold(), statistic.shape).copy()
        return Verdict(statistic, threshold, statistic > threshold)

    def look(self, statistic, age_s):
        return statistic

    def raise_threshold(self):
        return self.limit


class GrowingThreshold(AverageRate):
    """Its threshold is twice as large after five minutes, and grows on."""

    doubles_after_s = 300.0

    def raise_threshold(self):
        return self.limit * (1.0 + self.memory["age_s"][:, None] / self.doubles_after_s)


class BlindAfterFiveMinutes(AverageRate):
    """It sees nothing once it has been on for five minutes."""

    sees_for_s = 300.0

    def look(self, statistic, age_s):
        return np.where(age_s > self.sees_for_s, 0.0, statistic)
