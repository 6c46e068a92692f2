"""GNSS spoofing and its detection as a game.

All of it is simulation at the level of measurements, for defence research: no radio signal is
ever generated.

**Map**, from the ground up

core         no physics: registry, settings, files, memory, threads, compiled code
earth        ellipsoid and gravity, frames, attitude
truth        what really happens: flights, sensors, clocks, satellites, errors, noise
data         recorded flights and navigation files
attacks      what a spoofer can physically do to measurements
receiver     the victim: strapdown, tightly and loosely coupled filters, least squares, replay
policies     what a learned policy is: contract, ONNX model, card
detectors    one algorithm or family a file, behind one contract
simulation   B receivers of one kind of victim in step, without Gymnasium
calibration  thresholds from clean runs, for a rate of false alarms
limits       what no attack, and no detector, exceeds
spoofers     scripted and learned ones, which decide what the attack does
envs         what Gymnasium sees: one step path over any victim, terms, pictures
tasks        tasks for spoofers and for detectors, frozen settings
duel         the game of a spoofer and a detector, its two forms and the views of one side
bench        detectors x spoofers x paired seeds: runs, scores, searches, experiments, reports
duel_v0      what is public of the duel, for PettingZoo and Gymnasium
wrappers     detectors as Gymnasium wrappers: recorder, check, score
testing      check_detector, check_attack, check_spoofer, check_stationary, check_ages
export       from a model to an ONNX file with its card
sb3          the vector environment of stable-baselines3, and a callback that scores
cli          the command line: `spoofgym --help`

`spoofgym.audit` says what the worst attack does to any detector, `spoofgym.evaluate` scores any
spoofer by the rule of the benchmark, and `spoofgym.evaluate_wrapped` a detector that is a wrapper.
`spoofgym.InnovationLog` holds what the filter of any receiver left of its measurements.

**Frames**

e  Earth-centred, Earth-fixed (WGS-84).
n  local north, east, down.
b  body: forward, right, down; the antenna and the inertial sensors are at its origin.

A suffix gives the axes of a vector: `velocity_n`, `specific_force_b`.  `C_nb` is the matrix to n
from b; inner letters meet in a product, ``C_en @ C_nb``.

**Units**

SI and radians inside.  At borders (settings, observations, info keys, files, command line) names
end with their unit: `_m`, `_mps`, `_mps2`, `_deg`, `_s`.

**States**

The filter's 17 states are the errors of attitude about ECEF axes, velocity and position (estimate
minus truth), then of accelerometer bias, gyro bias, and clock bias and drift in units of range
(truth minus estimate).  The loosely coupled filter has 15: attitude, velocity and position about
local east, north and up, in metres, then gyro and accelerometer biases.

**Vocabulary**

A *spoofer* decides, an *attack* obeys physics, a *detector* judges an *epoch* and raises an
*alarm* where its *statistic* exceeds its *threshold*; a *scenario* is flight x errors x grade of
the sensors.  Prefixes say whose value it is: `true_`, `estimated_`, `counterfeit_`.

**Environments**

Importing the package registers them for `gymnasium.make` and `gymnasium.make_vec`; their ids are
listed below. The duel of a spoofer and a detector is `spoofgym.duel_v0`, for PettingZoo.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING, Any

from .core.startup import check_python as _check_python
from .core.startup import start_program as _start_program

_check_python()
_start_program()  # before what takes a second

from gymnasium.envs.registration import register  # noqa: E402

from .tasks import DEFAULT_TASK as _DEFAULT_TASK  # noqa: E402
from .tasks import DETECTOR_TASKS as _DETECTOR_TASKS  # noqa: E402
from .tasks import TASKS as _TASKS  # noqa: E402

if TYPE_CHECKING:
    from .bench.experiments.audit import audit as audit
    from .bench.experiments.evaluate import evaluate as evaluate
    from .receiver.log import InnovationLog as InnovationLog
    from .wrappers.evaluate import evaluate_wrapped as evaluate_wrapped

__version__ = "0.1.0.dev0"

_ENV, _VIEW = "spoofgym.envs:Spoof{}Env", "spoofgym.duel.views:Spoofer{}View"
_WORLD = _TASKS[_DEFAULT_TASK].env_kwargs
_OFFSETS = {"control": "rate", "basis": "satellites", "decision_interval_s": 10.0}
_KWARGS: dict[str, dict[str, Any]] = {
    "TightlyCoupled-v0": _WORLD,
    "Zhong2025-v0": {},
    "Offsets-v0": {**_WORLD, **_OFFSETS, "between": "linear"},
    "LooselyCoupled-v0": {"victim": "loosely-coupled"},
    "Snapshot-v0": {"victim": "snapshot"},
    "WheeledRobot-v0": {"victim": "wheeled-robot"},
}
_SIDES = ("Spoofer", "Detector")
_DETECTOR_VIEW = "spoofgym.duel_v0:Detector{}View"
for _id, _kind, _kwargs in (
    *((f"spoofgym/{x}", _ENV, kwargs) for x, kwargs in _KWARGS.items()),
    *((f"spoofgym/{x}View-v0", f"spoofgym.duel_v0:{x}{{}}View", {}) for x in _SIDES),
    *((x.env_id, _VIEW if x.pooled else _ENV, x.env_kwargs) for x in _TASKS.values()),
    *((x.env_id, _DETECTOR_VIEW, x.env_kwargs) for x in _DETECTOR_TASKS.values()),
):
    register(
        id=_id,
        entry_point=_kind.format(""),
        vector_entry_point=_kind.format("Vector"),
        kwargs=_kwargs,
    )

_LAZY = {
    "audit": "bench.experiments.audit",
    "evaluate": "bench.experiments.evaluate",
    "evaluate_wrapped": "wrappers.evaluate",
    "InnovationLog": "receiver.log",
}


def __getattr__(name: str) -> Any:
    """What is imported on first use, since its import is slow."""
    if name in _LAZY:
        return getattr(_import_module(f"{__name__}.{_LAZY[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
