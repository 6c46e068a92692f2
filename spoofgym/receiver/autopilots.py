"""Logs of autopilots: the innovations of GNSS that a flight controller wrote down.

PX4 writes ULog files, whose topics differ by version. Its filter logs state less measurement; here
the sign is that of an `Epoch`. Channels are north, east and down.

What flags say not to be of GNSS is left out: the fields of GNSS also hold innovations of a position
that the filter assumes as long as it has none, and wild values before the first fix is fused.
`InnovationLog.about` says what was found, left out and trusted.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.extras import name_extra
from ..core.reading import name_file, read_file
from ..core.registry import require
from .log import PAIRS, InnovationLog

FloatArray = NDArray[np.float64]
Columns = Mapping[str, NDArray[Any]]
Topics = Mapping[tuple[str, int], Columns]
"""Columns of topics by name and instance, in the order of time."""

LARGEST_FLIGHT = 2**29  # of a file [bytes], some hours
MOST_FIELDS = 4096  # of a topic with the types in it
GAP = 5.0  # median intervals without an innovation, after which a new segment begins
MOST_AWAY_S = 1.0  # a variance from its innovation
CHANNELS = ("north", "east", "down")
GNSS, GNSS_HEIGHT = 2, 11  # bits of `control_mode_flags`, which say what is being fused

_gps = ("gps_hpos[0]", "gps_hpos[1]", "gps_vpos", "gps_hvel[0]", "gps_hvel[1]", "gps_vvel")
_old = (3, 4, 5, 0, 1, 2)
INNOVATIONS = {
    "estimator_innovations": ("estimator_innovation_variances", _gps, _gps),
    "ekf2_innovations": (
        "ekf2_innovations",
        tuple(f"vel_pos_innov[{k}]" for k in _old),
        tuple(f"vel_pos_innov_var[{k}]" for k in _old),
    ),
}
"""Topics of innovations, newest first: the topic of their variances, and the fields of both, of
positions north, east and down, then of velocities."""
RESETS = ("estimator_status", "estimator_local_position", "vehicle_local_position")
COUNTERS = ("reset_count_vel", "reset_count_po", "xy_reset", "z_reset", "vxy_reset", "vz_reset")
"""Topics that may count resets of the filter, the best first, and how names of counters begin."""
SELECTOR = "estimator_selector_status"
HOW_TO_LOG = (
    "it holds no innovations of EKF2: log the topics estimator_innovations, "
    "estimator_innovation_variances and estimator_status (up to PX4 1.10 ekf2_innovations and "
    "estimator_status), a line each in etc/logging/logger_topics.txt on the SD card"
)


class Rows(NamedTuple):
    """What a log holds, before anything is left out.

    - `time` (k,) [s]; `innovation`, `variance` (k, 6) positions, then velocities;
    - `fused` (k, 6) what flags say to be of GNSS and in use; `resets` (k, r) counters of resets.
    """

    time: FloatArray
    innovation: FloatArray
    variance: FloatArray
    fused: NDArray[np.bool_]
    resets: FloatArray


def read_ulog(path: Path) -> InnovationLog:
    """Innovations of EKF2 in a log of PX4."""
    with name_file(path):
        try:
            rows, about = _find_innovations(_parse_ulog(read_file(path, LARGEST_FLIGHT)))
        except KeyError as error:
            raise ValueError(f"a topic lacks the field {error}") from error
        return _make_log(rows, about)


class _Content(io.BytesIO):
    """A file that ends a reader's patience: pyulog 1.3 steps back for ever in some damaged ones."""

    def __init__(self, content: bytes) -> None:
        super().__init__(content)
        self.left = 4 * len(content) + 2**16

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        self.left -= max(len(data), 16)
        if self.left < 0:
            raise EOFError("too much of it is damaged")
        return data


def _parse_ulog(content: bytes) -> Topics:
    try:
        from pyulog import ULog
    except ImportError as error:
        raise name_extra("a ULog", error, "logs") from error
    wanted = [*INNOVATIONS, *(each[0] for each in INNOVATIONS.values()), *RESETS, SELECTOR]
    try:
        with redirect_stdout(io.StringIO()):
            head = ULog(_Content(content), parse_header_only=True)
            for name in head.message_formats:
                _count_fields(name, head.message_formats)
            data = ULog(_Content(content), wanted).data_list
    except Exception as error:  # of any kind, as damage has it
        raise ValueError(f"pyulog can't read it: {error}") from error
    topics = {}
    for each in sorted(data, key=lambda each: len(each.data[each.field_data[0].field_name])):
        order = np.argsort(each.data["timestamp"], kind="stable")
        topics[each.name, each.multi_id] = {key: x[order] for key, x in each.data.items()}
    return topics


def _count_fields(name: str, formats: Mapping[str, Any], above: tuple[str, ...] = ()) -> int:
    """Fields of a topic with those of the types within it, before they are laid out."""
    count = 0
    for kind, size, _ in formats[name].fields:
        require(kind not in above, f"the type {kind} holds itself")
        inner = _count_fields(kind, formats, (*above, name)) if kind in formats else 1
        count += max(size, 1) * inner
        require(count <= MOST_FIELDS, f"{name} has more than {MOST_FIELDS} fields")
    return max(count, 1)


def _find_innovations(topics: Topics) -> tuple[Rows, dict[str, Any]]:
    """Innovations with their variances and flags, and where they come from."""
    name = next((x for x in INNOVATIONS if any(x == topic for topic, _ in topics)), None)
    if name is None:
        raise ValueError(HOW_TO_LOG)
    instances = sorted(k for topic, k in topics if topic == name)
    instance = _find_primary(topics, instances)
    of_variances, fields, of_fields = INNOVATIONS[name]
    found, status = topics[name, instance], topics.get(("estimator_status", instance))
    variances = topics.get((of_variances, instance))
    if variances is None or status is None:
        lacking = of_variances if variances is None else "estimator_status"
        raise ValueError(f"{name} needs the topic {lacking}, which was not logged")
    time = _read_time(found)
    counter, resets = _read_resets(topics, instance, time)
    nearest, away = _find_nearest(_read_time(variances), time)
    fused = np.tile(_read_flag(status, GNSS, time)[:, None], 6)
    fused[:, 2] &= _read_flag(status, GNSS_HEIGHT, time)
    rows = Rows(
        time=time,
        innovation=-_stack(found, fields),
        variance=np.where(
            away[:, None] < MOST_AWAY_S, _stack(variances, of_fields)[nearest], np.nan
        ),
        fused=fused,
        resets=resets,
    )
    which = f"estimator {instance}" + (f" of {len(instances)}" if len(instances) > 1 else "")
    flags = f"bits {GNSS} (GNSS) and {GNSS_HEIGHT} (GNSS height) of control_mode_flags"
    return rows, {
        "found": f"{len(time)} epochs of {name}, {which}",
        "trusted": f"{flags}; {counter}",
    }


def _find_primary(topics: Topics, instances: list[int]) -> int:
    """The estimator that flew most of the time, of those that were logged."""
    selector = topics.get((SELECTOR, 0), {})
    chosen, counts = np.unique(selector.get("primary_instance", []), return_counts=True)
    for k in chosen[np.argsort(-counts, kind="stable")]:
        if k in instances:
            return int(k)
    return instances[0]


def _stack(columns: Columns, fields: tuple[str, ...]) -> FloatArray:
    return np.stack([columns[name].astype(np.float64) for name in fields], axis=1)


def _read_time(columns: Columns) -> FloatArray:
    """(k,) since boot [s]."""
    return columns["timestamp"].astype(np.float64) * 1e-6


def _find_nearest(when: FloatArray, time: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Rows of one topic nearest to those of another, as both may be thinned, and how far [s]."""
    after = np.searchsorted(when, time).clip(0, len(when) - 1)
    before = np.maximum(after - 1, 0)
    away = np.abs(np.stack([when[before], when[after]]) - time)
    return np.where(away[0] < away[1], before, after), away.min(axis=0)


def _read_flag(status: Columns, bit: int, time: FloatArray) -> NDArray[np.bool_]:
    """Whether a flag is set before and after each time: it may have changed in between."""
    flags = (status["control_mode_flags"].astype(np.uint64) >> np.uint64(bit)) & np.uint64(1) > 0
    before = np.searchsorted(_read_time(status), time, side="right") - 1
    after = np.minimum(before + 1, len(flags) - 1)
    return np.asarray((before >= 0) & flags[before] & flags[after])


def _read_resets(topics: Topics, instance: int, time: FloatArray) -> tuple[str, FloatArray]:
    for topic in RESETS:
        columns = topics.get((topic, 0 if topic.startswith("vehicle") else instance), {})
        if fields := tuple(name for name in columns if name.startswith(COUNTERS)):
            before = np.searchsorted(_read_time(columns), time, side="right") - 1
            return f"counters of resets of {topic}", _stack(columns, fields)[np.maximum(before, 0)]
    return "no counters of resets, which were not logged", np.zeros((len(time), 0))


def _make_log(rows: Rows, about: dict[str, Any]) -> InnovationLog:
    """Log of the innovations that remain, and in `about` how many were left out and why."""
    finite = np.isfinite(rows.innovation) & np.isfinite(rows.variance) & (rows.variance > 0.0)
    used = rows.fused & finite
    why = {
        "without a time": rows.time <= 0.0,
        "not of GNSS, as flags say": ~rows.fused.any(axis=1),
        "without a variance": ~used.any(axis=1),
    }
    reason = np.select(list(why.values()), [1, 2, 3], 0)
    kept = np.flatnonzero(reason == 0)
    x = np.where(used, rows.innovation, np.nan)[kept]
    same = ((x[1:] == x[:-1]) | (np.isnan(x[1:]) & np.isnan(x[:-1]))).all(axis=1)
    again = np.concatenate([[False], same | (np.diff(rows.time[kept]) <= 0.0)])[: len(kept)]
    left_out = {name: int((reason == k).sum()) for k, name in enumerate(why, 1)}
    left_out["repeated"] = int(again.sum())
    kept, x = kept[~again], x[~again]
    about = {**about, "left_out": {name: count for name, count in left_out.items() if count}}
    reasons = ", ".join(f"{count} {name}" for name, count in about["left_out"].items())
    require(
        len(kept) > 1,
        f"{len(kept)} innovations of GNSS are left of {about['found']}; left out: {reasons}",
    )
    if height := int((~used[kept, 2]).sum()):
        about["left_out"]["positions down, whose height is not of GNSS"] = height
    time = rows.time[kept]
    gap = np.diff(time) > GAP * np.median(np.diff(time))
    reset = (np.diff(rows.resets[kept], axis=0) != 0.0).any(axis=1)
    unused = np.diff(np.cumsum(reason > 0)[kept]) > 0
    segment = np.concatenate([[0], np.cumsum(gap | reset | unused)])
    return InnovationLog(
        time=time,
        innovation=x,
        innovation_cov=np.where(used, rows.variance, 1.0)[kept][:, :, None] * np.eye(6),
        channels=CHANNELS,
        signals=PAIRS[1],
        segment=segment.astype(np.int64),
        about=about,
    )
