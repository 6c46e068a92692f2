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


MESSAGES = {
    "XKF3": ("QBcccccchhhccff", "TimeUS,C,IVN,IVE,IVD,IPN,IPE,IPD,IMX,IMY,IMZ,IYAW,IVT,RErr,ErSc"),
    "XKF4": ("QBcccccfffHBIHb", "TimeUS,C,SV,SP,SH,SM,SVT,errRP,OFN,OFE,FS,TS,SS,GPS,PI"),
    "PARM": ("QNff", "TimeUS,Name,Value,Default"),
}
LETTERS = {"N": "16s", "c": "h"}


def write_dataflash(path: Path, rows: list[tuple[str, dict[str, Any]]]) -> Path:
    """A log of ArduPilot: `rows` are names of `MESSAGES` with values by column, else 0."""
    parts = []
    for number, (name, (letters, columns)) in enumerate(MESSAGES.items(), 10):
        form = "<" + "".join(LETTERS.get(x, x) for x in letters)
        texts = name.encode(), letters.encode(), columns.encode()
        parts.append(
            struct.pack("<3sBB4s16s64s", b"\xa3\x95\x80", number, 3 + struct.calcsize(form), *texts)
        )
        for _, row in (each for each in rows if each[0] == name):
            values = [row.get(x, b"" if x == "Name" else 0) for x in columns.split(",")]
            parts.append(
                struct.pack("<3s", b"\xa3\x95" + bytes([number])) + struct.pack(form, *values)
            )
    path.write_bytes(b"".join(parts))
    return path


def fly_ardupilot(
    believed: float = 1.0, seconds: float = 60.0, height: int = 3, seed: int = 0
) -> tuple[list[tuple[str, dict[str, Any]]], Any]:
    """Rows of two cores, of which core 1 flies, and its true innovations (k, 6) of 5 Hz."""
    rng = np.random.default_rng(seed)
    time = 1.0 + 0.2 * np.arange(round(5 * seconds))
    z = np.round(SD * rng.standard_normal((len(time), 6)), 2)
    S = (believed * SD) ** 2
    gates = {"EK3_VEL_I_GATE": 300, "EK3_POS_I_GATE": 500, "EK3_SRC1_POSZ": height}
    rows = [("PARM", {"Name": name.encode(), "Value": x}) for name, x in gates.items()]
    for t, x in zip(time, z, strict=True):
        shown = np.where(t < FUSED_S, [0, 300.0, 0, 0, 0, 0], -x)
        ratios = [
            np.sqrt((x[part] ** 2).sum() / S[part].sum()) / gate
            for part, gate in ((slice(3, 6), 3.0), (slice(0, 2), 5.0), (slice(2, 3), 5.0))
        ]
        flags = 1 << 13 if t >= FUSED_S else 1 << 7
        for core in (0, 1):
            common = {"TimeUS": round(1e6 * t), "C": core}
            cm = np.round(100 * (shown if core else 2 * shown)).clip(-32768, 32767).astype(int)
            names = ("IPN", "IPE", "IPD", "IVN", "IVE", "IVD")
            rows.append(("XKF3", {**common, **dict(zip(names, cm.tolist(), strict=True))}))
            tests = dict(zip(("SV", "SP", "SH"), (int(100 * r) for r in ratios), strict=True))
            offset = {"OFN": 2.5 * (t > RESET_S), "SS": flags, "PI": 1}
            rows.append(("XKF4", {**common, **tests, **offset}))
    return rows, z
