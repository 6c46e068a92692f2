"""Worlds, sensors and errors that an episode may have, and what the victim assumes of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..earth.attitude import euler_to_dcm
from ..receiver import TightlyCoupled
from ..receiver.augmented import SignalModel, signal_model
from ..receiver.matching import assumed_noise
from ..receiver.tight import NoiseModel
from ..sim.chain import chain_worlds
from ..sim.constellation import CircularConstellation
from ..sim.gnss import ERRORS, GnssErrors
from ..sim.imu import IMU_GRADES, ImuGrade
from ..sim.scenario import Scenario
from ..sim.world import World
from .domain import Domain

FloatArray = NDArray[np.float64]


class Combination(NamedTuple):
    """One combination of world, grade and errors, and what the victim assumes there.

    `bias_sd` (n,) of the satellites' constant biases [m]; `noise_variance` (2n,) R;
    `epoch_variance` (2n,) what it assumes of one epoch alone; `noise` of clock and inertial
    sensors; `noise_psd` (17,) of its states; `covariance` (17, 17) at the start; `assumed` errors
    of the signals, and `assumed_bias_sd` (n,) of their constants [m].
    """

    grade: ImuGrade
    errors: GnssErrors
    bias_sd: FloatArray
    noise_variance: FloatArray
    epoch_variance: FloatArray
    noise: NoiseModel
    noise_psd: FloatArray
    covariance: FloatArray
    assumed: GnssErrors
    assumed_bias_sd: FloatArray


def worlds_of(scenario: Scenario, domain: Domain) -> list[World]:
    if not domain.varies and domain.worlds is None and domain.pairs() == [(0.0, 0.0)]:
        return [scenario.world()]
    constellation = scenario.constellation
    if not isinstance(constellation, CircularConstellation):
        raise ValueError(
            "`domain` can move a CircularConstellation alone in time, got "
            f"{type(constellation).__name__}"
        )
    if isinstance(scenario.flight, str):
        # a world knows nothing of these
        bare = replace(scenario, errors="white", imu="aviation", name="")
        return _remembered(bare, constellation, domain)
    return _variants(scenario, constellation, domain)


@lru_cache(maxsize=2)
def _remembered(scenario: Scenario, base: CircularConstellation, domain: Domain) -> list[World]:
    return _variants(scenario, base, domain)


def _variants(scenario: Scenario, base: CircularConstellation, domain: Domain) -> list[World]:
    return [
        replace(
            scenario,
            turned_deg=scenario.turned_deg + turn,
            constellation=replace(base, time_offset_s=base.time_offset_s + time),
        ).world()
        for turn, time in domain.pairs()
    ]


class Combinations:
    """All combinations of world, grade and errors. `epochs`: of an episode, which a matched
    receiver knows; `flown`: epochs of the flight that any episode may come to; `world`: all worlds,
    one after the other; `names`: of the grades, ``"imu"``, and of the errors, ``"errors"``."""

    def __init__(
        self,
        worlds: Sequence[World],
        scenario: Scenario,
        receiver: TightlyCoupled,
        domain: Domain,
        epochs: int,
        flown: int,
    ) -> None:
        self.world, self.worlds = chain_worlds(worlds), len(worlds)
        self.names = {"imu": domain.imu or (scenario.imu,), "errors": domain.errors or ("own",)}
        named = [ERRORS[name] for name in domain.errors]
        errors = named or [scenario.gnss_errors]
        assumed = named or [scenario.assumed_errors]
        self.drawn = (scenario.turn_on if domain.turn_on is None else domain.turn_on) == "drawn"
        events = scenario.events if domain.events is None else domain.events
        self.events = events if events is not None and events.any else None
        self.with_signals = self.events is not None or any(each.signals for each in errors)
        self._grades = [IMU_GRADES[name] for name in self.names["imu"]]
        self.grades, self.errors = len(self._grades), len(errors)
        grades = self.names["imu"]
        victims = [(g, replace(receiver, grade=g) if domain.imu else receiver) for g in grades]
        self._all = [
            _combination(world, grade, error, belief, victim, epochs, flown)
            for world in worlds
            for grade, victim in victims
            for error, belief in zip(errors, assumed, strict=True)
        ]
        self._first_C_eb = [_first_attitudes(self.world, grade) for grade in self._grades]

    def index(
        self, world: NDArray[np.int64], grade: NDArray[np.int64], error: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """(b,) index, for `__getitem__`, of combinations of a `Choice`."""
        return (world * self.grades + grade) * self.errors + error

    def signal_model(self, interval_s: float) -> SignalModel:
        """States of the signals of an augmented filter; a ValueError where combinations differ."""
        first = self._all[0]
        for case in self._all:
            same = case.assumed == first.assumed and case.grade == first.grade
            if not (same and np.array_equal(case.assumed_bias_sd, first.assumed_bias_sd)):
                raise ValueError(
                    "a receiver with `tuning` 'augmented' takes one grade of inertial sensors and "
                    "one kind of errors, with the same constants in all worlds of the domain"
                )
        return signal_model(first.assumed, first.assumed_bias_sd, interval_s)

    def __getitem__(self, index: int) -> Combination:
        return self._all[index]

    @property
    def assume_alike(self) -> bool:
        """Whether victims assume the same noise in all of them."""
        first = self._all[0]
        return all(
            np.array_equal(case.noise_variance, first.noise_variance)
            and np.array_equal(case.noise_psd, first.noise_psd)
            for case in self._all
        )

    @property
    def sense_alike(self) -> bool:
        """Whether sensors have the same constants in all episodes of all of them."""
        first = self._all[0]
        return not self.drawn and all(
            case.grade is first.grade and case.errors == first.errors for case in self._all
        )

    @property
    def largest_epoch_variance(self) -> FloatArray:
        """(2n,) largest variance of one epoch alone of all combinations."""
        largest: FloatArray = np.max([case.epoch_variance for case in self._all], axis=0)
        return largest

    @property
    def largest_variance(self) -> FloatArray:
        """(2n,) largest R of all combinations."""
        largest: FloatArray = np.max([case.noise_variance for case in self._all], axis=0)
        return largest

    def first_C_eb(self, grade: NDArray[np.int64], epochs: NDArray[np.int64]) -> FloatArray:
        """(b, 3, 3) attitudes, to ECEF from body axes, with which receivers start at `epochs`."""
        pairs = zip(grade.tolist(), epochs.tolist(), strict=True)
        return np.array([self._first_C_eb[g][k] for g, k in pairs])


def _combination(
    world: World,
    grade: str,
    errors: GnssErrors,
    assumed: GnssErrors,
    receiver: TightlyCoupled,
    epochs: int,
    flown: int,
) -> Combination:
    elevation = world.first_elevation
    bias_sd = errors.bias_sd(elevation)
    believed = assumed.bias_sd(elevation)
    variance, noise = assumed_noise(receiver, assumed, believed, world, epochs, flown)
    single = variance
    if receiver.matches:
        interval_s = float(world.epoch_time[1] - world.epoch_time[0])
        rates = np.full(len(bias_sd), assumed.rate_sd(interval_s) ** 2)
        single = np.concatenate([assumed.epoch_variance(elevation), rates])
    psd, covariance = receiver.noise_psd(noise), receiver.initial_covariance(noise)
    sheet = IMU_GRADES[grade]
    sheet = sheet._replace(  # the increments are quantized before they are summed up
        accel_quantization=sheet.accel_quantization / world.decimation,
        gyro_quantization=sheet.gyro_quantization / world.decimation,
    )
    return Combination(
        sheet, errors, bias_sd, variance, single, noise, psd, covariance, assumed, believed
    )


def _first_attitudes(world: World, grade: ImuGrade) -> FloatArray:
    """(K, 3, 3) attitudes with the grade's first error, for a start at every epoch."""
    error = euler_to_dcm(*(-np.radians(grade.attitude_error_deg)))
    # the error turns the local axes: C_nb (estimated) = dC C_nb
    C_ne = np.ascontiguousarray(world.C_en.transpose(0, 2, 1))
    return world.C_en @ (error.T @ (C_ne @ world.C_eb))
