"""Small logs of autopilots for tests and the fuzzer, as their formats say, and a flight in them."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

KINDS = {"uint64_t": "<u8", "uint32_t": "<u4", "uint8_t": "u1", "float": "<f4"}
GPS = ("float[2] gps_hpos", "float gps_vpos", "float[2] gps_hvel", "float gps_vvel")
SD = np.array([2.0, 2.0, 3.0, 0.3, 0.3, 0.4])
FUSED_S, RESET_S, GAP_S = 6.0, 30.0, (40.0, 45.0)


def message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


Topics = dict[tuple[str, int], dict[str, Any]]


def write_ulog(path: Path, topics: Topics) -> Path:
    """`topics`: by name and instance, columns by "type name"; the first is "uint64_t timestamp"."""
    formats, joins, rows = {}, [], []
    for number, ((name, instance), columns) in enumerate(topics.items()):
        formats[name] = message("F", f"{name}:{''.join(f'{key};' for key in columns)}".encode())
        joins.append(message("A", struct.pack("<BH", instance, number) + name.encode()))
        kinds = [KINDS[key.split()[0].partition("[")[0]] for key in columns]
        parts = [
            np.asarray(x).astype(kind) for x, kind in zip(columns.values(), kinds, strict=True)
        ]
        for k, time in enumerate(parts[0]):
            body = b"".join(part[k].tobytes() for part in parts)
            rows.append((time, message("D", struct.pack("<H", number) + body)))
    rows.sort(key=lambda row: row[0])
    head = b"ULog\x01\x12\x35\x01" + bytes(8)
    path.write_bytes(head + b"".join([*formats.values(), *joins, *(row for _, row in rows)]))
    return path


def microseconds(time: Any) -> Any:
    return np.round(1e6 * time).astype(np.uint64)


def split(values: Any) -> Any:
    """(k, 6) positions and velocities as the fields of `GPS`."""
    return values[:, :2], values[:, 2], values[:, 3:5], values[:, 5]


def fly(
    believed: float = 1.0,
    seconds: float = 60.0,
    old: bool = False,
    height: bool = True,
    seed: int = 0,
) -> tuple[Topics, Any]:
    """Topics of a flight, published twice for every fix of 5 Hz, and its true innovations (k, 6).

    Before GNSS is fused positions are wild; a reset and a gap follow. `believed`: how many times
    its noise the filter assumes.
    """
    rng = np.random.default_rng(seed)
    time = 1.0 + 0.1 * np.arange(round(10 * seconds))
    z = np.repeat(SD * rng.standard_normal((len(time) // 2, 6)), 2, axis=0)
    shown = -np.where((time < FUSED_S)[:, None], [0.0, 1e6, 0.0, 0.0, 0.0, 0.0], z)
    variance = np.tile((believed * SD) ** 2, (len(time), 1))
    there = (time < GAP_S[0]) | (time > GAP_S[1])
    when, stamp = np.arange(0.5, seconds + 2.0, 1.0), "uint64_t timestamp"
    flags = np.where(when >= FUSED_S, 1 << 2 | height << 11, 0)
    status = {stamp: microseconds(when), "uint32_t control_mode_flags": flags}
    if old:
        both = {"float[6] vel_pos_innov": shown, "float[6] vel_pos_innov_var": variance}
        columns = {key: np.roll(x, 3, axis=1)[there] for key, x in both.items()}
        return {
            ("ekf2_innovations", 0): {stamp: microseconds(time)[there], **columns},
            ("estimator_status", 0): status,
        }, z
    status["uint8_t reset_count_pos_ne"] = when > RESET_S
    status["uint8_t reset_count_quat"] = np.arange(len(when)) % 2
    return {
        **{
            (topic, 0): {
                stamp: microseconds(time)[there] + late,
                **dict(zip(GPS, (x[there] for x in split(values)), strict=True)),
            }
            for topic, values, late in (
                ("estimator_innovations", shown, 0),
                ("estimator_innovation_variances", variance, 4000),
            )
        },
        ("estimator_status", 0): status,
    }, z
