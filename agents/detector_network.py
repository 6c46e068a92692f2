r"""A network that judges epochs: alike for all satellites, and causal in time.

What is observed of a satellite goes through one encoder, the same for all, and is pooled over those
in view (mean and maximum, `zaheer2017`): which slot a satellite has makes no difference.  Where
lines of sight :math:`u_i` are observed, innovations are projected on them, too,

.. math:: p = \frac1n \sum_i u_i (w_i - \bar w), \qquad w_i = W x_i

with learned W and without the mean, which is the receiver's clock.  These vectors are averaged
exponentially over fixed horizons, and their lengths are what follows sees: a false position moves
them all along its own direction, whichever that is.  A gated recurrent unit takes in the pooled
codes, the lengths, and what is observed of the receiver as a whole, such as the statistics of
classic detectors.  What it hands on to the next epoch is its hidden state and the averages, both 0
at switch-on.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

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
