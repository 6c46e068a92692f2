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

Importing the package registers, for `gymnasium.make` and `gymnasium.make_vec`,
``spoofgym/TightlyCoupled-v0``, the world and the detector of task S1, ``spoofgym/Offsets-v0``, the
same with an action for every satellite, ``spoofgym/Zhong2025-v0``, the same victim in the fixed and
fast world of a paper, and the small environments ``spoofgym/LooselyCoupled-v0``,
``spoofgym/Snapshot-v0`` and ``spoofgym/WheeledRobot-v0``.  The duel of a spoofer and a detector is
`spoofgym.duel_v0`, for PettingZoo; one side of it against frozen opponents is
``spoofgym/SpooferView-v0`` or ``spoofgym/DetectorView-v0``.
"""

from typing import TYPE_CHECKING, Any

from .core.startup import start_program as _start_program

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

register(
    id="spoofgym/TightlyCoupled-v0",
    entry_point="spoofgym.envs:SpoofEnv",
    vector_entry_point="spoofgym.envs:SpoofVectorEnv",
    kwargs=_TASKS[_DEFAULT_TASK].env_kwargs,
)

register(
    id="spoofgym/Zhong2025-v0",
    entry_point="spoofgym.envs:SpoofEnv",
    vector_entry_point="spoofgym.envs:SpoofVectorEnv",
)

register(
    id="spoofgym/Offsets-v0",
    entry_point="spoofgym.envs:SpoofEnv",
    vector_entry_point="spoofgym.envs:SpoofVectorEnv",
    kwargs={
        **_TASKS[_DEFAULT_TASK].env_kwargs,
        "control": "rate",
        "basis": "satellites",
        "decision_interval_s": 10.0,
        "between": "linear",
    },
)

register(
    id="spoofgym/LooselyCoupled-v0",
    entry_point="spoofgym.envs:SpoofEnv",
    vector_entry_point="spoofgym.envs:SpoofVectorEnv",
    kwargs={"victim": "loosely-coupled"},
)

register(
    id="spoofgym/Snapshot-v0",
    entry_point="spoofgym.envs:SpoofEnv",
    vector_entry_point="spoofgym.envs:SpoofVectorEnv",
    kwargs={"victim": "snapshot"},
)

register(
    id="spoofgym/WheeledRobot-v0",
    entry_point="spoofgym.envs:SpoofEnv",
    vector_entry_point="spoofgym.envs:SpoofVectorEnv",
    kwargs={"victim": "wheeled-robot"},
)

register(
    id="spoofgym/SpooferView-v0",
    entry_point="spoofgym.duel_v0:SpooferView",
    vector_entry_point="spoofgym.duel_v0:SpooferVectorView",
)

register(
    id="spoofgym/DetectorView-v0",
    entry_point="spoofgym.duel_v0:DetectorView",
    vector_entry_point="spoofgym.duel_v0:DetectorVectorView",
)

for _task in _TASKS.values():
    register(
        id=_task.env_id,
        entry_point="spoofgym.duel.views:SpooferView" if _task.pooled else "spoofgym.envs:SpoofEnv",
        vector_entry_point="spoofgym.duel.views:SpooferVectorView"
        if _task.pooled
        else "spoofgym.envs:SpoofVectorEnv",
        kwargs=_task.env_kwargs,
    )

for _detector_task in _DETECTOR_TASKS.values():
    register(
        id=_detector_task.env_id,
        entry_point="spoofgym.duel_v0:DetectorView",
        vector_entry_point="spoofgym.duel_v0:DetectorVectorView",
        kwargs=_detector_task.env_kwargs,
    )


def __getattr__(name: str) -> Any:
    """What is imported on first use, since its import is slow."""
    if name == "evaluate":
        from .bench.experiments.evaluate import evaluate

        return evaluate
    if name == "audit":
        from .bench.experiments.audit import audit

        return audit
    if name == "evaluate_wrapped":
        from .wrappers.evaluate import evaluate_wrapped

        return evaluate_wrapped
    if name == "InnovationLog":
        from .receiver.log import InnovationLog

        return InnovationLog
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
