r"""Networks that judge epochs, causal in time.

`DetectorNetwork` is alike for all satellites.  What is observed of one goes through one encoder,
the same for all, and is pooled over those in view (mean and maximum, `zaheer2017`): which slot a
satellite has makes no difference.  Where lines of sight :math:`u_i` are observed, innovations are
projected on them, too,

.. math:: p = \frac1n \sum_i u_i (w_i - \bar w), \qquad w_i = W x_i

with learned W and without the mean, which is the receiver's clock.  These vectors are averaged
exponentially over fixed horizons, and their lengths are what follows sees: a false position moves
them all along its own direction, whichever that is.  A gated recurrent unit takes in the pooled
codes, the lengths, and what is observed of the receiver as a whole, such as the statistics of
classic detectors.  What it hands on to the next epoch is its hidden state and the averages, both 0
at switch-on.

`WindowNetwork` takes the white shifts of the term `filter-shift`, two vectors an epoch.  Their sums
over the last epochs, in windows of fixed lengths, over the root of the number of epochs, have
variance 1 at any age.  Learned combinations of the windows are matched filters, whose lengths do
not depend on the heading of an attack; with what is observed of the receiver as a whole they go
through two layers.  It remembers the epochs of its longest window, and nothing else.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from spoofgym.detectors.observation import SHIFTED
from spoofgym.export import CHANNELS

SLOT = re.compile(r"(.+)_slot(\d+)")
SIGHTS = ("sight_north", "sight_east", "sight_down")
VISIBLE = "visible"
HORIZONS_S = (0.0, 5.0, 20.0, 60.0, 180.0)
"""Time constants of the averages; 0 for none."""
FARTHEST = 10.0
"""Standard deviations, of clean observations, beyond which an element is not taken to lie."""
LEAST_SCALE = 0.05
"""Of what hardly differs, such as what the filter believes of itself."""
SMALL = 1e-6
BLOCK = 40
"""Epochs that are averaged by one product of matrices."""
SHIFTS = tuple(f"shift_{what}_{axis}" for what in SHIFTED for axis in ("north", "east"))
WINDOWS_S = (0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 80.0)
"""Lengths of the sums; 0 for the last epoch alone."""


class DetectorNetwork(nn.Module):
    """Statistic of every epoch.

    - `names`: (o,) name of every element of an observation; ``..._slotNN`` are those of a
      satellite, and ``visible`` must be among these;
    - `interval_s`: time between epochs;
    - `width`: units of the recurrent unit; the encoder has half of them;
    - `projections`: vectors p.
    """

    def __init__(
        self, names: Sequence[str], interval_s: float, width: int = 32, projections: int = 8
    ) -> None:
        super().__init__()
        words: dict[str, list[int]] = {}
        whole = []
        for place, name in enumerate(names):
            found = SLOT.fullmatch(name)
            if found is None:
                whole.append(place)
            else:
                words.setdefault(found[1], []).append(place)
        if VISIBLE not in words:
            raise ValueError(
                f"observations must have {VISIBLE}_slotNN, which satellites are in view (the term "
                f"'in-view'); got {', '.join(words) or 'nothing'} of slots"
            )
        self.sighted = all(word in words for word in SIGHTS)
        own = [word for word in words if word not in (*SIGHTS, VISIBLE)]
        self.words = tuple(own)
        self.register_buffer("slots", torch.tensor([words[word] for word in own]).T.contiguous())
        self.register_buffer("shown", torch.tensor(words[VISIBLE]))
        sights = [words[word] for word in SIGHTS] if self.sighted else [[]] * 3
        self.register_buffer("sights", torch.tensor(sights, dtype=torch.long).T.contiguous())
        self.register_buffer("whole", torch.tensor(whole, dtype=torch.long))
        for name, size in (("slot", len(own)), ("whole", len(whole))):
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_scale", torch.ones(size))
        pace = [interval_s / max(h, interval_s) for h in HORIZONS_S]
        self.register_buffer("pace", torch.tensor(pace)[:, None])
        self.vectors = 3 * projections if self.sighted else 0
        self.hidden_size, self.average_size = width, len(pace) * self.vectors
        encoded = len(own) + (3 if self.sighted else 0)
        self.encoder = nn.Sequential(
            nn.Linear(encoded, width // 2), nn.ReLU(), nn.Linear(width // 2, width // 2), nn.ReLU()
        )
        self.project = nn.Linear(len(own), projections, bias=False)
        self.lengths = 2 * len(pace) * projections if self.sighted else 0
        seen = 2 * (width // 2) + len(whole) + self.lengths
        self.mix = nn.Linear(seen, width)
        self.recurrent = nn.GRU(width, width, batch_first=True)
        self.head = nn.Linear(2 * width, 1)
        nn.init.constant_(self.head.bias, -2.0)

    @property
    def channels(self) -> int:
        """Slots of the receiver."""
        return len(self.shown)

    @property
    def state(self) -> dict[str, int]:
        """Size of each state by name, for `spoofgym.export.detector`."""
        own = {"hidden": self.hidden_size}
        return own | ({"average": self.average_size} if self.average_size else {})

    def normalize_by(self, observation: NDArray[np.float32]) -> None:
        """Take centre and scale of every kind of element from clean observations, (N, o)."""
        seen = torch.as_tensor(observation)
        shown = seen[:, self.shown] > 0.5
        for k in range(len(self.words)):
            values = seen[:, self.slots[:, k]][shown]
            self.slot_mean[k] = values.mean()
            self.slot_scale[k] = values.std().clamp(min=LEAST_SCALE)
        self.whole_mean.copy_(seen[:, self.whole].mean(dim=0))
        self.whole_scale.copy_(seen[:, self.whole].std(dim=0).clamp(min=LEAST_SCALE))

    def encode(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What an epoch shows by itself: (..., k) codes, and (..., v) vectors."""
        shown = observation[..., self.shown][..., None]
        x = (observation[..., self.slots] - self.slot_mean) / self.slot_scale
        x = x.clamp(-FARTHEST, FARTHEST) * shown
        whole = (observation[..., self.whole] - self.whole_mean) / self.whole_scale
        whole = whole.clamp(-FARTHEST, FARTHEST)
        count = total(shown).clamp(min=1.0)
        parts, vectors = [whole], x.new_zeros((*x.shape[:-2], 0))
        encoded = x
        if self.sighted:
            sights = observation[..., self.sights]
            encoded = torch.cat([x, sights], dim=-1)
            weight = self.project(x) * shown
            weight = (weight - (total(weight) / count)[..., None, :]) * shown
            along = [total(sights[..., k, None] * weight) / count for k in range(3)]
            vectors = torch.cat(along, dim=-1)
        code = self.encoder(encoded) * shown
        return torch.cat([*parts, total(code) / count, code.amax(dim=-2)], dim=-1), vectors

    def averages(self, vectors: torch.Tensor) -> torch.Tensor:
        """Exponential averages of (B, L, v), from 0 on: (B, L, s, v); a block of epochs at once."""
        left = 1.0 - self.pace  # (s, 1)
        age = torch.arange(BLOCK, device=vectors.device)
        late = (age[:, None] - age).clamp(min=0)
        taken = torch.where(
            age[:, None] >= age, self.pace[..., None] * left[..., None] ** late, 0.0
        )
        fading = left ** (age + 1)  # (s, k)
        before = vectors.new_zeros((len(vectors), len(left), vectors.shape[-1]))
        found = []
        for block in vectors.split(BLOCK, dim=1):
            k = block.shape[1]
            new = torch.einsum("stu,buv->btsv", taken[:, :k, :k], block)
            new = new + fading.T[:k, :, None] * before[:, None]
            found.append(new)
            before = new[:, -1]
        return torch.cat(found, dim=1)

    def measure(self, average: torch.Tensor) -> torch.Tensor:
        """Horizontal and vertical lengths of averages (..., s, v), in their size if white."""
        if not self.sighted:
            return average.flatten(start_dim=-2)
        scaled = average * torch.sqrt((2.0 - self.pace) / self.pace)
        north, east, down = scaled.unflatten(-1, (3, -1)).unbind(dim=-2)
        flat = torch.sqrt(north * north + east * east + SMALL)
        return torch.cat([flat, torch.sqrt(down * down + SMALL)], dim=-1).flatten(start_dim=-2)

    def judge(self, mixed: torch.Tensor, hidden: torch.Tensor) -> torch.Tensor:
        """Logarithm of the odds of an attack: (...)."""
        return self.head(torch.cat([mixed, hidden], dim=-1)).squeeze(-1)

    def log_odds(self, observation: torch.Tensor) -> torch.Tensor:
        """Of whole episodes, (B, L, o), from switch-on on; returns (B, L)."""
        code, vectors = self.encode(observation)
        if self.sighted:
            code = torch.cat([code, self.measure(self.averages(vectors))], dim=-1)
        mixed = torch.relu(self.mix(code))
        return self.judge(mixed, self.recurrent(mixed)[0])

    def forward(
        self, observation: torch.Tensor, hidden: torch.Tensor, average: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, ...]:
        """One epoch: (B, o), and states; returns (B, 1) statistic in [-1, 1], and the next states.
        The statistic is l / (1 + |l|) of the log odds l.  A sigmoid of 17 is 1 in single precision;
        here neighbouring numbers are 3e-5 apart in l at l = 20, so that thresholds for rare false
        alarms can be told apart."""
        code, vectors = self.encode(observation)
        if average is not None:
            before = average.unflatten(-1, (len(self.pace), self.vectors))
            after = before + self.pace * (vectors[:, None] - before)
            code = torch.cat([code, self.measure(after)], dim=-1)
        mixed = torch.relu(self.mix(code))
        hidden = self._recur(mixed, hidden)
        statistic = functional.softsign(self.judge(mixed, hidden))[:, None]
        if average is None:
            return statistic, hidden
        return statistic, hidden, after.flatten(start_dim=1)

    def _recur(self, mixed: torch.Tensor, hidden: torch.Tensor) -> torch.Tensor:
        """One step of the recurrent unit, written out: its operator takes whole sequences."""
        unit = self.recurrent
        given = functional.linear(mixed, unit.weight_ih_l0, unit.bias_ih_l0).chunk(3, dim=-1)
        kept = functional.linear(hidden, unit.weight_hh_l0, unit.bias_hh_l0).chunk(3, dim=-1)
        reset, update = (torch.sigmoid(given[k] + kept[k]) for k in (0, 1))
        new = torch.tanh(given[2] + reset * kept[2])
        return (1.0 - update) * new + update * hidden


class WindowNetwork(nn.Module):
    """Statistic of every epoch, from a past that is as long as its longest window.

    - `names`: (o,) name of every element of an observation, `SHIFTS` among them; the others are of
      the receiver as a whole;
    - `interval_s`: time between epochs;
    - `width`: units of each of the two layers;
    - `projections`: combinations of the windows.
    """

    channels = CHANNELS  # of the receiver; nothing that it observes is of a slot

    def __init__(
        self, names: Sequence[str], interval_s: float, width: int = 32, projections: int = 8
    ) -> None:
        super().__init__()
        if missing := [name for name in SHIFTS if name not in names]:
            raise ValueError(
                f"observations must have {', '.join(missing)} (the term 'filter-shift')"
            )
        if slots := [name for name in names if SLOT.fullmatch(name)]:
            raise ValueError(f"a window network observes no slots, got {', '.join(slots[:4])}")
        whole = [place for place, name in enumerate(names) if name not in SHIFTS]
        self.register_buffer("shifts", torch.tensor([names.index(name) for name in SHIFTS]))
        self.register_buffer("whole", torch.tensor(whole, dtype=torch.long))
        self.register_buffer("whole_mean", torch.zeros(len(whole)))
        self.register_buffer("whole_scale", torch.ones(len(whole)))
        self.windows = [max(round(length / interval_s), 1) for length in WINDOWS_S]
        longest = max(self.windows)
        boxes = torch.zeros(len(self.windows), longest)
        for row, window in zip(boxes, self.windows, strict=True):
            row[longest - window :] = 1.0
        self.register_buffer("boxes", boxes)
        vectors = 2 * len(self.windows)
        self.project = nn.Linear(vectors, projections, bias=False)
        seen = len(whole) + 2 * (vectors + projections)
        self.layers = nn.Sequential(
            nn.Linear(seen, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.head = nn.Linear(width + seen, 1)
        nn.init.constant_(self.head.bias, -2.0)

    @property
    def state(self) -> dict[str, int]:
        """Size of each state by name, for `spoofgym.export.detector`."""
        return {"past": (self.boxes.shape[1] - 1) * (len(SHIFTS) + 1)}

    def normalize_by(self, observation: NDArray[np.float32]) -> None:
        """Take centre and scale of the rest from clean observations, (N, o)."""
        seen = torch.as_tensor(observation)[:, self.whole]
        self.whole_mean.copy_(seen.mean(dim=0))
        self.whole_scale.copy_(seen.std(dim=0).clamp(min=LEAST_SCALE))

    def judge(self, observation: torch.Tensor, sums: torch.Tensor) -> torch.Tensor:
        """Logarithm of the odds of an attack: (...), of (..., o) and the sums (..., 5, W) of shifts
        and of epochs."""
        count = sums[..., -1:, :].clamp(min=1.0)
        # both kinds in all windows, of each axis
        vectors = (sums[..., :-1, :] / torch.sqrt(count)).unflatten(-2, (2, 2))
        vectors = vectors.transpose(-3, -2).flatten(start_dim=-2)
        north, east = torch.cat([vectors, self.project(vectors)], dim=-1).unbind(dim=-2)
        square = north * north + east * east
        whole = (observation[..., self.whole] - self.whole_mean) / self.whole_scale
        whole = whole.clamp(-FARTHEST, FARTHEST)
        seen = torch.cat([whole, torch.sqrt(square + SMALL), 0.1 * square], dim=-1)
        seen = seen.clamp(-FARTHEST, FARTHEST)
        return self.head(torch.cat([self.layers(seen), seen], dim=-1)).squeeze(-1)

    def log_odds(self, observation: torch.Tensor) -> torch.Tensor:
        """Of whole episodes, (B, L, o), from switch-on on; returns (B, L)."""
        shifts = observation[..., self.shifts].double()
        so_far = torch.cat([shifts, torch.ones_like(shifts[..., :1])], dim=-1).cumsum(dim=1)
        sums = []
        for window in self.windows:
            late = functional.pad(so_far, (0, 0, window, 0))[:, : so_far.shape[1]]
            sums.append((so_far - late).float())
        return self.judge(observation, torch.stack(sums, dim=-1))

    def forward(self, observation: torch.Tensor, past: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """One epoch: (B, o) and the past; returns (B, 1) statistic in [-1, 1], as that of
        `DetectorNetwork`, and the next past."""
        shifts = observation[:, self.shifts]
        new = torch.cat([shifts, 0.0 * shifts[:, :1] + 1.0], dim=-1)[..., None]
        before = past.unflatten(-1, (len(SHIFTS) + 1, -1))
        odds = self.judge(observation, functional.linear(before, self.boxes[:, :-1]) + new)
        after = torch.cat([before[..., 1:], new], dim=-1).flatten(start_dim=1)
        return functional.softsign(odds)[:, None], after


NETWORKS: dict[str, Any] = {"recurrent": DetectorNetwork, "window": WindowNetwork}


def total(values: torch.Tensor) -> torch.Tensor:
    """Sum over satellites, (..., n, k) to (..., k), in the same order for any batch. onnxruntime's
    own sums are not the same to the last bit, and so would be refused."""
    first, *rest = values.unbind(dim=-2)
    for each in rest:
        first = first + each
    return first


def compute_statistic(log_odds: NDArray[np.float32]) -> NDArray[np.float64]:
    """The statistic of `DetectorNetwork.forward` in [0, 1], as a receiver compares it."""
    wide = np.asarray(log_odds, dtype=np.float64)
    return 0.5 * (1.0 + wide / (1.0 + np.abs(wide)))


def count_parameters(network: nn.Module) -> int:
    return sum(math.prod(each.shape) for each in network.parameters())
