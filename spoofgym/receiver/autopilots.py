"""Logs of autopilots: the innovations of GNSS that a flight controller wrote down.

PX4 writes ULog files, whose topics differ by version, and ArduPilot writes DataFlash, which has
test ratios instead of variances. Both log state less measurement; here the sign is that of an
`Epoch`. Channels are north, east and down.

What flags say not to be of GNSS is left out: the fields of GNSS also hold innovations of a position
that the filter assumes as long as it has none, and wild values before the first fix is fused.
`InnovationLog.about` says what was found, left out and trusted.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
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
DAMAGED = "too much of it is damaged"
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
    return _read_log(path, lambda content: _find_innovations(_parse_ulog(content)))


def read_dataflash(path: Path) -> InnovationLog:
    """Innovations of EKF3 in a log of ArduPilot, whose variances follow from its test ratios."""
    return _read_log(path, lambda content: _find_ratios(_parse_dataflash(content)))


def _read_log(path: Path, read: Callable[[bytes], tuple[Rows, dict[str, Any]]]) -> InnovationLog:
    with name_file(path):
        try:
            rows, about = read(read_file(path, LARGEST_FLIGHT))
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
            raise EOFError(DAMAGED)
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
    fused = np.tile(_read_flag(status, "control_mode_flags", time, GNSS)[:, None], 6)
    fused[:, 2] &= _read_flag(status, "control_mode_flags", time, GNSS_HEIGHT)
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


def _read_flag(
    status: Columns, name: str, time: FloatArray, on: int, off: int | None = None
) -> NDArray[np.bool_]:
    """Whether a bit is set, and another is not, before and after each time, between which they may
    have changed."""
    bits = status[name].astype(np.uint64)
    flags = (bits >> np.uint64(on)) & np.uint64(1) > 0
    if off is not None:
        flags &= (bits >> np.uint64(off)) & np.uint64(1) == 0
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


FORMATS = {
    **{"b": "i1", "B": "u1", "M": "u1", "h": "<i2", "H": "<u2", "c": "<i2", "C": "<u2"},
    **{"i": "<i4", "I": "<u4", "e": "<i4", "E": "<u4", "L": "<i4", "q": "<i8", "Q": "<u8"},
    **{"f": "<f4", "d": "<f8", "g": "<f2", "n": "S4", "N": "S16", "Z": "S64", "a": "S64"},
}
"""Fields of a DataFlash message by the letter of its format; those of cCeE are hundredths."""
EKF3 = ("XKF3", "XKF4", "PARM")
USING_GPS, ASSUMED = 13, 7  # bits of XKF4.SS: GNSS is used; a position is assumed
GATES = ("EK3_POS_I_GATE", "EK3_HGT_I_GATE", "EK3_VEL_I_GATE")
GATE = 500.0  # hundredths of a standard deviation, where a log has no parameters
HALF = 0.005  # of the step to which test ratios are cut off
SMOOTH_S = 5.0  # before and after, from which variances follow
NO_EKF3 = (
    "it holds no XKF3 and XKF4: fly with EKF3 (AHRS_EKF_TYPE 3) and log attitude (LOG_BITMASK), "
    "with which ArduPilot logs them"
)


def _parse_dataflash(content: bytes) -> dict[str, Columns]:
    """Columns of the messages `EKF3`: a log says itself what its messages hold."""
    kinds = {128: (89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")}
    places: dict[int, list[int]] = {}
    at = skipped = 0
    while (at := content.find(b"\xa3\x95", at)) >= 0 and at + 3 <= len(content):
        kind = content[at + 2]
        length = kinds[kind][0] if kind in kinds else 0
        if not length or at + length > len(content):
            at, skipped = at + 1, skipped + 1
            require(skipped < 1000 + len(content) // 64, DAMAGED)
            continue
        if kind == 128:
            new, size = content[at + 3 : at + 5]
            texts = content[at + 5 : at + 9], content[at + 9 : at + 25], content[at + 25 : at + 89]
            name, fields, columns = (x.split(b"\0")[0].decode("latin-1") for x in texts)
            if size > 3:
                kinds.setdefault(new, (size, name, fields, columns))
        elif kinds[kind][1] in EKF3:
            places.setdefault(kind, []).append(at + 3)
        at += length
    found: dict[str, Columns] = {}
    for kind, starts in places.items():
        length, name, fields, columns = kinds[kind]
        names = columns.split(",")
        layout = np.dtype([(x, FORMATS[letter]) for x, letter in zip(names, fields, strict=True)])
        require(
            layout.itemsize == length - 3, f"the format of {name} has another length than it says"
        )
        rows = np.frombuffer(b"".join(content[k : k + length - 3] for k in starts), layout)
        found[name] = {
            x: rows[x] * 0.01 if letter in "cCeE" else rows[x]
            for x, letter in zip(names, fields, strict=True)
        }
    return found


def _find_ratios(messages: Mapping[str, Columns]) -> tuple[Rows, dict[str, Any]]:
    """Innovations of EKF3, with the variances that its test ratios and gates stand for."""
    if any(name not in messages for name in EKF3[:2]):
        raise ValueError(NO_EKF3)
    primary, counts = np.unique(messages["XKF4"]["PI"], return_counts=True)
    core = primary[counts.argmax()]
    found, status = (_sort(messages[name], core) for name in EKF3[:2])
    parameters = messages.get("PARM", {"Name": np.array([]), "Value": np.array([])})
    values = dict(zip(parameters["Name"].tolist(), parameters["Value"].tolist(), strict=True))
    time = _read_time(found)
    innovation = -_stack(found, ("IPN", "IPE", "IPD", "IVN", "IVE", "IVD"))
    nearest, away = _find_nearest(_read_time(status), time)
    ratio = np.where(
        away[:, None] < MOST_AWAY_S, _stack(status, ("SP", "SH", "SV"))[nearest], np.nan
    )
    gate = np.maximum([0.01 * values.get(name.encode(), GATE) for name in GATES], 1.0)
    used = _read_flag(status, "SS", time, USING_GPS, off=ASSUMED)
    near = np.searchsorted(time, [time - SMOOTH_S, time + SMOOTH_S])
    variance = np.empty_like(innovation)
    for k, part in enumerate((slice(0, 2), slice(2, 3), slice(3, 6))):
        square = np.mean(innovation[:, part] ** 2, axis=1)
        of_sd = (gate[k] * (ratio[:, k] + HALF)) ** 2
        sums = [np.cumsum([0.0, *np.where(used & (of_sd > 0.0), x, 0.0)]) for x in (square, of_sd)]
        above, below = (x[near[1]] - x[near[0]] for x in sums)
        variance[:, part] = np.divide(above, below, where=below > 0.0, out=0.0 * below)[:, None]
    fused = np.tile(used[:, None], 6)
    fused[:, 2] &= values.get(b"EK3_SRC1_POSZ") == 3
    resets = _stack(status, ("OFN", "OFE"))[nearest]
    return Rows(time, innovation, variance, fused, resets), {
        "found": f"{len(time)} epochs of XKF3, core {core}",
        "trusted": f"bits {USING_GPS} (uses GPS) and {ASSUMED} (assumes a position) of XKF4.SS, "
        "EK3_SRC1_POSZ, resets of XKF4.OFN and OFE",
        "reconstructed": "variances, from innovations and test ratios of XKF4 within "
        f"{SMOOTH_S:g} s, the same for all axes of a test; gates: "
        + ", ".join(f"{name} {100.0 * x:g}" for name, x in zip(GATES, gate, strict=True)),
    }


def _sort(columns: Columns, core: int) -> Columns:
    """Rows of a core in the order of time."""
    order = np.argsort(columns["TimeUS"], kind="stable")
    order = order[columns["C"][order] == core]
    require(len(order) > 0, f"core {core}, which flew, was not logged")
    return {
        **{name: x[order] for name, x in columns.items()},
        "timestamp": columns["TimeUS"][order],
    }


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
    good = np.flatnonzero(reason == 0)
    x = np.where(used, rows.innovation, np.nan)[good]
    same = ((x[1:] == x[:-1]) | (np.isnan(x[1:]) & np.isnan(x[:-1]))).all(axis=1)
    again = np.concatenate([[False], same | (np.diff(rows.time[good]) <= 0.0)])[: len(good)]
    left_out = {name: int((reason == k).sum()) for k, name in enumerate(why, 1)}
    left_out["repeated"] = int(again.sum())
    good, x = good[~again], x[~again]
    about = {**about, "left_out": {name: count for name, count in left_out.items() if count}}
    reasons = ", ".join(f"{count} {name}" for name, count in about["left_out"].items())
    require(
        len(good) > 1,
        f"{len(good)} innovations of GNSS are left of {about['found']}; left out: {reasons}",
    )
    if height := int((~used[good, 2]).sum()):
        about["left_out"]["positions down, whose height is not of GNSS"] = height
    time = rows.time[good]
    gap = np.diff(time) > GAP * np.median(np.diff(time))
    reset = (np.diff(rows.resets[good], axis=0) != 0.0).any(axis=1)
    unused = np.diff(np.cumsum(reason > 0)[good]) > 0
    segment = np.concatenate([[0], np.cumsum(gap | reset | unused)])
    return InnovationLog(
        time=time,
        innovation=x,
        innovation_cov=np.where(used, rows.variance, 1.0)[good][:, :, None] * np.eye(6),
        channels=CHANNELS,
        signals=PAIRS[1],
        segment=segment.astype(np.int64),
        about=about,
    )
