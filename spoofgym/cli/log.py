"""Spoofgym log: innovations of anyone's receiver, checked and judged."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from . import options as opt
from .app import clear_errors, print_json, print_lines, print_written

if TYPE_CHECKING:
    from ..receiver.log import InnovationLog

group = typer.Typer(
    help="Innovations of a receiver's log: do they fit their variances, and what do detectors see?",
    no_args_is_help=True,
)
File = Annotated[
    Path,
    Argument(
        help="Log: a table (.csv, .parquet) with the columns time_s, channel, signal, innovation, "
        "variance, or matrices (.npz)."
    ),
]


@group.command("check")
@clear_errors
def check_log(log: File, as_json: opt.Json = False) -> None:
    """Say how innovations fit their variances: mean square, whiteness, constant part, tails."""
    from ..bench.report.table import Table
    from ..receiver.log import InnovationLog

    found = InnovationLog.load(log)
    rows = [each._asdict() for each in found.check_signals()]
    remarks = found.list_remarks()
    about = {
        "epochs": len(found.time),
        "duration_s": round(found.duration_s, 3),
        "interval_s": round(found.interval_s, 6),
        "segments": len(set(found.segment.tolist())),
        "channels": list(found.channels),
    }
    if as_json:
        print_json({**about, "signals": rows, "remarks": remarks})
        return
    print_lines([_describe_size(found)])
    Table(
        ("signal", "signal"),
        ("innovations", "innovations"),
        ("square over variance", lambda r: f"{r['nis']:.3g} ({r['low']:.3g} to {r['high']:.3g})"),
        ("factor on the sd", lambda r: f"{r['sd_factor']:.3g}"),
        ("lag-1 correlation", lambda r: f"{r['lag1']:.2f}"),
        ("constant part [sd]", lambda r: f"{r['constant']:.2f}"),
        ("beyond 3 sd [%]", lambda r: f"{100.0 * r['beyond_3']:.2g}"),
        ("largest [sd]", lambda r: f"{r['largest']:.3g}"),
    ).print("innovations", rows)
    print_lines(remarks)


@group.command("judge")
@clear_errors
def judge_(
    log: File,
    detector: Annotated[list[str], Option(help=f"Detector, may be repeated. {opt.SPEC_HELP}")],
    false_alarms_per_hour: Annotated[
        float | None,
        Option(
            help="Take thresholds from this log's own windows, for so many false alarms an hour. "
            "The log must be clean. Default: the thresholds that a detector has by itself."
        ),
    ] = None,
    window_s: Annotated[float, Option(help="Length of a window, in seconds.")] = 160.0,
    as_json: opt.Json = False,
) -> None:
    """Play detectors over a log: alarms, and the largest ratio of statistic to threshold."""
    from ..bench.report.table import Table
    from ..calibration.log import judge_log
    from ..receiver.log import InnovationLog

    found = InnovationLog.load(log)
    specs = opt.parse_specs(detector)
    rows = [
        {**each.as_json(), "detector": text}
        for text, each in zip(
            detector, judge_log(found, specs, false_alarms_per_hour, window_s), strict=True
        )
    ]
    if as_json:
        print_json(rows)
        return
    Table(
        ("detector", "detector"),
        ("epochs with alarm", lambda r: f"{r['alarms']} of {r['epochs']}"),
        ("windows with alarm", lambda r: f"{r['windows_with_alarm']} of {r['windows']}"),
        ("largest ratio", lambda r: f"{r['largest_ratio']:.3g}"),
        ("median ratio", lambda r: f"{r['median_ratio']:.3g}"),
        ("factor on the threshold", lambda r: f"{r['threshold_factor']:.3g}"),
    ).print(f"windows of {window_s:g} s", rows)
    if false_alarms_per_hour is None:
        print_lines(
            ["Thresholds are those of the detectors; no rate of false alarms is known here."]
        )


@group.command("import")
@clear_errors
def import_log(
    files: Annotated[
        list[Path],
        Argument(
            help="Log of PX4 (.ulg) or ArduPilot (.bin), a table (.csv, .parquet) or matrices "
            "(.npz); or raw measurements: observations (RINEX 2 or 3, or a table of RXM-RAWX), "
            "navigation files (RINEX), and a table of inertial samples."
        ),
    ],
    out: Annotated[Path, Option("--out", "-o", help="File to write, .npz or .csv.")],
    mapping: Annotated[
        Path | None,
        Option(help="TOML file that says what the columns of the inertial samples are."),
    ] = None,
    static: Annotated[
        bool, Option("--static", help="The receiver was at rest; no inertial samples.")
    ] = False,
    grade: Annotated[str, Option(help="Grade of the inertial sensors.")] = "consumer",
    noise_factors: Annotated[
        tuple[float, float],
        Option(
            help="Factors on the standard deviations of pseudoranges and range rates, those of the "
            "receiver itself or 2.5 m and 0.1 m/s."
        ),
    ] = (1.0, 1.0),
) -> None:
    """Write a log of an autopilot, or of a filter run over raw measurements, as one of innovations;
    or such a log in the other form."""
    from ..receiver.autopilots import read_dataflash, read_ulog
    from ..receiver.log import InnovationLog
    from ..receiver.raw_measurements import read_raw_log

    if len(files) > 1 or mapping is not None or static:
        found = read_raw_log(
            files, mapping, static=static, grade=grade, noise_factors=noise_factors
        )
    else:
        readers = {".ulg": read_ulog, ".bin": read_dataflash}
        found = readers.get(files[0].suffix.lower(), InnovationLog.load)(files[0])
    print_lines(_describe_import(found))
    print_written([found.save(out)])


def _describe_size(log: InnovationLog) -> str:
    return (
        f"{len(log.time)} epochs in {len(set(log.segment.tolist()))} segments, "
        f"{log.duration_s:.6g} s, one every {log.interval_s:.6g} s, of {len(log.channels)} channels"
    )


def _describe_import(log: InnovationLog) -> list[str]:
    """What a reader found, left out and trusted, and how the rest fits its variances."""
    lines = []
    for key, value in log.about.items():
        if key == "lines":
            lines += value
            continue
        if isinstance(value, Mapping):
            value = ", ".join(f"{count} {reason}" for reason, count in value.items()) or "nothing"
        lines.append(f"{key.replace('_', ' ')}: {value}")
    medians = [f"{each.median:.2g} ({each.signal})" for each in log.check_signals()]
    return [*lines, f"kept: {_describe_size(log)}; median NIS {', '.join(medians)}"]
