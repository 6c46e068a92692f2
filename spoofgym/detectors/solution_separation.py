r"""Solution separation: the filter's solution against those that have taken no GNSS for a while.

A coasting solution starts as a copy of the filter at an epoch :math:`k_0`, and follows the inertial
sensors alone from then on.  By how much the filter has moved away from it needs no second filter,

.. math::
    s_k = \Phi_k s_{k-1} - K_k z_k, \qquad
    V_k = \Phi_k V_{k-1} \Phi_k^T + K_k S_k K_k^T, \qquad s_{k_0} = 0, \; V_{k_0} = 0,

and the statistic is the largest, over a bank of J such solutions, of the horizontal

.. math:: q = s_h^T V_h^{-1} s_h \sim \chi^2(2)

against the quantile T of :math:`\alpha / J`.  A solution that coasts since before an attack began
knows nothing of it.  So **whatever the attack is**, it shifts :math:`s_h` by just the horizontal
error that it has induced.  While there is no alarm,

.. math:: \lVert s_h \rVert \le \sqrt{T \, \lambda_{\max}(V_h)},

which is known before any attack (`bound_m`).  The clean part of :math:`s_h` has mean zero and
covariance :math:`V_h`, so that this bounds the mean displacement by an attack that stays below the
threshold for certain, and that of one run but for the clean part.

One solution restarts every D epochs, so that there is always one of each age from D to J D epochs,
in steps of D: for an attack of any length up to :math:`(J - 1) D` one that is older by at most D.
A bank of geometric spacing (`space_geometrically`) has few solutions for a long attack.  The claim
is made for attacks no longer than `covers_s` that began after the detector, and for no other.

A solution that coasts since before the attack has an error of covariance :math:`P + V`, attacked or
not.  So without an alarm the horizontal error exceeds the **protection level**

.. math::
    \mathrm{HPL} = \max_{t \le L} \min_{j: t_j \ge t} \left( K_{fa} \sqrt{\lambda_{\max}(V_h)}
        + K_{md} \sqrt{\lambda_{\max}(P_h + V_h)} \right), \qquad
    K_{fa} = \sqrt{T}, \quad K_{md} = \sqrt{-2 \ln P_{md}}

with a probability of at most :math:`P_{md}` at an epoch, under any attack that is no longer than L
and began after the detector: that of the time t ago is answered by any solution of an age
:math:`t_j` no less, and the largest is that of the longest attack (`blanch2012`, there for each
axis, with satellites left out in place of times).

With a filter of its own (`own_filter`) the recursion is that of the innovations and gains of that
filter.  Its solution separates from those that coast, and is bounded, not the victim's; the
protection level of the victim has their distance added.

Symbols: z innovation, S its covariance, K gain, :math:`\Phi` transition of the error states,
:math:`s_h` north and east part at the predicted position, :math:`\alpha` false-alarm probability of
one epoch, L `longest_s`, :math:`\lambda_{\max}` largest eigenvalue, P covariance of the filter
after its update, :math:`P_{md}` (`MISSED`) probability that an error beyond HPL is missed.

Assumptions: the filter is linear in its errors, and its gain that of its own belief,
:math:`K = P H^T S^{-1}`; below the receiver's fewest satellites it coasts.  No other detector takes
weight off measurements, or the filter moves less than is reckoned here.  The distribution, not the
shift, needs white innovations of covariance S, and then :math:`V = P_{\mathrm{coast}} - P`.  A
receiver that is tuned ``augmented`` has them in its own world; others need a calibration, and with
its factor on T the bound changes, too.  All this is to first order: an attack that turns the
filter's heading by degrees, as one of 35 m in a minute does in a straight flight, shifts
:math:`s_h` by up to a quarter less than its error; one of some metres, which is what the threshold
allows there, by 1 or 2 % less.  Where the filter has learnt since what a solution could not know,
such as the heading in the first turn of a flight, :math:`V_h` is large and the bound loose.

Differences to `tanil2018`, after which it is: there the innovations themselves are summed up, and
the risk is that of the worst attack on this sum.  The separation is a linear combination of the
same innovations, which are independent of the filter's present error (`joerger2013`); that it
bounds any attack follows from the recursion.  Bank and schedule are ours.  States for the errors of
signals, which move no other state, are left out of s and V.  A solution is not judged while
:math:`V_h` is nearly singular.
"""

from __future__ import annotations

import math
from typing import ClassVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy import special

from ..core.declared import setting, settings_record
from ..earth.wgs84 import dcm_e_from_n, ecef_to_geodetic
from ..receiver.epoch import Epoch
from ..receiver.states import POSITION, STATES
from ._anchored_bank_kernels import advance_anchored, anchored_shapes
from ._solution_separation_kernels import advance_bank, judge_bank, whiten_bank
from .base import MISSED, DetectorContext, FloatArray, IntArray, Verdict, compare
from .innovation import alarm_probability, count_epochs
from .own_filter import FilterTest, filter_to_test

MOST_SOLUTIONS = 100
ANCHORED = "epochs", "separation", "covariance", "reach", "since", "place", "spread"  # memory


Starts = tuple[IntArray, IntArray]  # (J,) first starts and periods of solutions [epochs]


def space_equally(longest: int, spacing: int) -> Starts:
    """One start every `spacing`, in turn."""
    bank = math.ceil(longest / spacing) + 1
    return np.arange(bank) * spacing, np.full(bank, bank * spacing)


def space_geometrically(longest: int, spacing: int) -> Starts:
    r"""Ages that double.

    Solutions of level i start at odd multiples of :math:`2^i D`, two of them in turn, and those of
    the highest level I at all multiples of :math:`2^I D`.  For an attack of any length t up to the
    longest there is one older by at most D or 2/3 t.
    """
    levels = max(0, math.ceil(math.log2(longest / (3.0 * spacing)) - 1e-9))
    top = 2**levels * spacing
    count = math.ceil(longest / top) + 1
    firsts, periods = [np.arange(count) * top], [np.full(count, count * top)]
    for step in (2**i * spacing for i in range(levels)):
        firsts.append(np.array([step, 3 * step]))
        periods.append(np.full(2, 4 * step))
    return np.concatenate(firsts), np.concatenate(periods)


SPACINGS = {"equal": space_equally, "geometric": space_geometrically}


@settings_record
class SolutionSeparation(FilterTest):
    """Separation of the filter from solutions that coast since several times; monitor only."""

    false_alarm: float = alarm_probability(
        help="Probability of an alarm in one epoch where the filter's belief is right; shared "
        "out to the solutions of the bank, so that the true one is smaller."
    )
    longest_s: float = setting(
        default=160.0,
        least=1e-3,
        unit="s",
        help="Length of the longest attack whose displacement is to be bounded.",
    )
    spacing_s: float = setting(
        default=20.0,
        least=1e-3,
        unit="s",
        help="Time between two restarts in the bank: by at most this a solution is older than an "
        "attack.  The bank has `longest_s` / `spacing_s` + 1 solutions.",
    )
    filter: str = filter_to_test()
    spacing: str = setting(
        default="equal",
        one_of=SPACINGS,
        newer=True,
        help="How the ages of the solutions are spaced: equally, or such that they double from "
        "`spacing_s` on.",
    )

    paper: ClassVar[str] = "tanil2018"
    needs: ClassVar[frozenset[str]] = frozenset(
        {"transition", "design", "predicted_cov", "innovation_cov"}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.spacing == "equal" and self.longest_s > MOST_SOLUTIONS * self.spacing_s:
            raise ValueError(
                f"`longest_s` must be at most {MOST_SOLUTIONS} times `spacing_s`, got "
                f"{self.longest_s} and {self.spacing_s}"
            )

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        if context.states < POSITION + 3:
            raise ValueError(
                "solution-separation needs a filter that carries attitude, velocity and position "
                f"from epoch to epoch; this victim's has {context.states} states"
            )
        b, tracked = context.receivers, min(self._states, self._inertial)
        self._interval_s, self._fewest = context.epoch_interval_s, context.min_satellites
        longest = math.ceil(self.longest_s / context.epoch_interval_s - 1e-9)
        spacing = count_epochs(self.spacing_s, context)
        self._starts = SPACINGS[self.spacing](longest, spacing)
        firsts, periods = self._starts
        bank, self.memory_epochs = len(firsts), int(periods.max())
        # a solution starts again by the largest step between two starts of the oldest ones
        self._covers = self.memory_epochs - int(firsts[1] - firsts[0])
        self._threshold = float(special.chdtri(2.0, self.false_alarm / bank))
        self.memory.declare_all(
            epochs=np.zeros(b, dtype=np.int64), largest_sd=np.full((b, bank), np.inf)
        )
        if self._own is None:
            shapes = {"separation": (tracked, bank), "covariance": (tracked, tracked, bank)}
        else:
            self._spacing, others = spacing, tracked - STATES
            self._rest = np.ascontiguousarray(self._own.rest[:others, :others])
            shapes = anchored_shapes(bank, tracked)
        self.memory.declare_all(**{name: np.zeros((b, *shape)) for name, shape in shapes.items()})

    def judge(self, epoch: Epoch) -> Verdict:
        return self.judge_filtered(self.filter_epoch(epoch))

    def judge_filtered(self, epoch: Epoch) -> Verdict:
        """Judge an epoch of the filter to test."""
        memory = self.memory
        rows = np.arange(len(epoch.time)) if self.judged_rows is None else self.judged_rows
        self._advance(epoch, rows)
        statistic = np.zeros((len(epoch.time), 1))
        place, largest_sd = epoch.predicted_position, memory["largest_sd"]
        judge_bank(rows, *self._bank, place, largest_sd, statistic[:, 0])
        return compare(statistic, self._threshold)

    def _advance(self, epoch: Epoch, rows: NDArray[np.intp]) -> None:
        memory, own = self.memory, self._own
        if own is not None:
            mine = own.top, self._rest, own.white, own.counts, self._spacing, *self._starts
            advance_anchored(rows, *mine, *(memory[name] for name in ANCHORED))
            return
        model = epoch.transition, epoch.predicted_cov, epoch.design, epoch.innovation_cov
        Phi, P, H, S = (cast(FloatArray, each) for each in model)
        bank = memory["epochs"], memory["separation"], memory["covariance"]
        seen = epoch.innovation, S, epoch.visible, self._fewest
        advance_bank(rows, Phi, P, H, *seen, *self._starts, *bank)

    @property
    def _bank(self) -> tuple[FloatArray, FloatArray, IntArray, IntArray, IntArray]:
        """Separations and covariances of position, epochs so far, and starts."""
        memory, place = self.memory, slice(POSITION, POSITION + 3)
        if self._own is None:
            s, V = memory["separation"][:, place], memory["covariance"][:, place, place]
        else:
            bank = len(self._starts[0])
            s, V = memory["place"][..., :bank], memory["spread"][..., :bank]
        return s, V, memory["epochs"], *self._starts

    def whiten(self, position_e: FloatArray) -> FloatArray:
        """(B, J, 2) separations of the last epoch, whitened to unit covariance, 0 where a solution
        is not judged, in the horizontal planes at positions (B, 3), ECEF [m]. They are linear in
        the innovations, and the statistic is the largest of their squared lengths."""
        found = np.empty((*self.memory["largest_sd"].shape, 2))
        whiten_bank(*self._bank, position_e, found)
        return found

    @property
    def covers_s(self) -> float:
        """Length of the longest attack whose displacement is bounded [s]; once it is bound."""
        return self._covers * self._interval_s

    def bound_m(self, attack_s: float) -> FloatArray:
        r"""Threshold at the last epoch as a horizontal displacement.

        Parameters
        ----------
        attack_s : float
            Time since the last epoch before the attack [s].

        Returns
        -------
        ndarray
            (B,) :math:`\sqrt{T \lambda_{\max}(V_h)}` of the solutions that are at least as old as
            the attack, the smallest [m]; infinite without one.  With a factor on the
            threshold (`Calibrated`) it is its root times as much.
        """
        age = self._ages()
        old = (age > 0) & (age >= attack_s / self._interval_s - 1e-9)
        sd = np.where(old, self.memory["largest_sd"], np.inf).min(axis=1)
        return np.asarray(math.sqrt(self._threshold) * sd)

    def _ages(self) -> IntArray:
        """(B, J) ages of the solutions [epochs], 0 of those that have not started."""
        firsts, periods = self._starts
        since = self.memory["epochs"][:, None] - 1 - firsts
        return np.asarray(np.where(since >= 0, since % periods + 1, 0))

    def protection_level(self, epoch: Epoch, scale: float = 1.0) -> FloatArray:
        """Horizontal protection level against attacks of up to `longest_s` that began after it.

        Parameters
        ----------
        epoch : Epoch
            That has just been judged; read-only.
        scale : float
            Factor on the threshold.

        Returns
        -------
        ndarray
            (B,) HPL [m].
        """
        north_east = dcm_e_from_n(*ecef_to_geodetic(epoch.predicted_position)[:2])[:, :, :2]
        V = np.einsum("bak,bacj,bcl->bjkl", north_east, self._bank[1], north_east)
        covariance, apart = self._updated(epoch)
        P = np.einsum("bak,bac,bcl->bkl", north_east, covariance, north_east)
        fa, md = math.sqrt(scale * self._threshold), math.sqrt(-2.0 * math.log(MISSED))
        level = fa * largest_root(V) + md * largest_root(V + P[:, None])
        longest = np.minimum(math.ceil(self.longest_s / self._interval_s), self.memory["epochs"])
        level = np.where(self._ages() >= longest[:, None], level, np.inf).min(axis=1)
        return np.asarray(level + np.hypot(*np.einsum("bak,ba->kb", north_east, apart)))

    def _updated(self, epoch: Epoch) -> tuple[FloatArray, FloatArray]:
        """(B, 3, 3) covariance of the tested filter's position after the update, and (B, 3) the
        victim's position less that one, ECEF [m^2], [m]."""
        place = slice(POSITION, POSITION + 3)
        if self._own is not None:
            filters, states = self.memory["filters"], self._own.states
            upper = np.triu(filters[:, place, place])
            P = upper + np.triu(upper, 1).transpose(0, 2, 1)
            return P, filters[:, place, states] - self.memory["feedback"][:, place].sum(axis=2)
        matrices = epoch.predicted_cov, epoch.design, epoch.innovation_cov
        P, H, S = (cast(FloatArray, each) for each in matrices)
        enough = epoch.visible.sum(axis=1) >= self._fewest
        seen = H @ P[:, :, place]
        taken = seen.transpose(0, 2, 1) @ np.linalg.solve(S, seen)
        return P[:, place, place] - enough[:, None, None] * taken, np.zeros((len(P), 3))


def largest_root(covariance: FloatArray) -> FloatArray:
    """Root of the largest eigenvalue of matrices (..., 2, 2)."""
    xx, yy, xy = covariance[..., 0, 0], covariance[..., 1, 1], covariance[..., 0, 1]
    return np.asarray(np.sqrt(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)))
