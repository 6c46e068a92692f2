"""Spoofgym log: innovations of anyone's receiver, checked, judged and attacked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from ..core.registry import require
from . import options as opt
from .app import clear_errors, print_json, print_lines, print_written

if TYPE_CHECKING:
    from ..receiver.log import InnovationLog

group = typer.Typer(
    help="Innovations of a receiver's log: do they fit their variances, what do detectors see, and "
    "what do they miss?",
    no_args_is_help=True,
)
Detectors = Annotated[list[str], Option(help=f"Detector, may be repeated. {opt.SPEC_HELP}")]
Rate = Annotated[
    float | None,
    Option(
        help="Take thresholds from this log's own windows, for this many false alarms an hour. "
        "The log must be clean. Default: the thresholds that a detector has by itself."
    ),
]
File = Annotated[
    Path,
    Argument(
        help="Log: a table (.csv, .parquet) with the columns time_s, channel, signal, innovation, "
        "variance, or matrices (.npz, .mat)."
    ),
]


@group.command("check")
@clear_errors
def check_log(log: File, as_json: opt.Json = False) -> None:
    """Say how innovations fit their variances: mean square, whiteness, constant part, tails."""
    from ..bench.report.table import Table
    from ..receiver.log import InnovationLog
    from ..receiver.log_noise import fit_noise_factors

    found = InnovationLog.load(log)
    noise = {name: each._asdict() for name, each in fit_noise_factors(found).items()}
    signals = found.check_signals()
    rows = [{**each._asdict(), "noise": noise.get(each.signal)} for each in signals]
    remarks = found.list_remarks()
    if as_json:
        print_json({**_count(found), "signals": rows, "remarks": remarks})
        return
    print_lines([_describe_size(found)])
    Table(
        ("signal", "signal"),
        ("innovations", "innovations"),
        ("square over variance", lambda r: f"{r['nis']:.3g} ({r['low']:.3g} to {r['high']:.3g})"),
        ("factor on the sd of S", lambda r: f"{r['sd_factor']:.3g}"),
        ("on that of R", lambda r: _format_noise(r["noise"])),
        ("lag-1 correlation", lambda r: f"{r['lag1']:.2f}"),
        ("constant part [sd]", lambda r: f"{r['constant']:.2f}"),
        ("beyond 3 sd [%]", lambda r: f"{100.0 * r['beyond_3']:.2g}"),
        ("largest [sd]", lambda r: f"{r['largest']:.3g}"),
    ).print("innovations", rows)
    if not noise:
        print_lines(
            ["No factor on R: that takes the filter's design, transition and predicted_cov."]
        )
    print_lines(remarks)


def _format_noise(noise: dict[str, float | None] | None) -> str:
    if noise is None:
        return "-"
    factor, before, after = (noise[key] for key in ("factor", "nis", "mended"))
    mended = "none" if factor is None else f"{factor:.3g}"
    return f"{mended} (NIS {before:.2g} to {after:.2g})"


@group.command("judge")
@clear_errors
def judge_(
    log: File,
    detector: Detectors,
    false_alarms_per_hour: Rate = None,
    window_s: float = Option(160.0, help="Length of a window, in seconds."),
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


@group.command("attack")
@clear_errors
def attack_(
    log: File,
    detector: Detectors,
    false_alarms_per_hour: Rate = None,
    attack_s: float = Option(150.0, help="Length of an attack, in seconds."),
    time_to_alert_s: float = Option(
        10.0, help="Time after the attack in which an alarm still counts, in seconds."
    ),
    heading_deg: float = Option(90.0, help="Where the false position goes, clockwise from north."),
    rate_limit_mps: float = Option(5.0, help="Largest rate of the false position."),
    spoofer: list[str] | None = Option(
        None,
        help="Spoofer to play, unscaled, in place of these attacks, may be repeated; a .json "
        f"file, such as an audit writes, too. {opt.SPEC_HELP}",
    ),
    out: Path | None = Option(None, "--out", "-o", help="Picture, .png, .svg or .pdf."),
    threads: opt.Threads = None,
    as_json: opt.Json = False,
) -> None:
    """Compute how far attacks get unseen on a clean log's noise, by its filter's linear response.

    The log needs the matrices of its filter.  Constant and accelerating ramps, a step and an
    optimized open-loop attack are played on its windows, each at two sizes: at the alarm
    budget, and where half of the windows alarm.
    """
    from ..bench.report.figures import Dot, DotRow, dots_height, draw_dots, save_drawing
    from ..bench.report.table import Table, interval, percent
    from ..bench.search.log_attack import MOVED, attack_log
    from ..core.plots import check_picture
    from ..receiver.log import InnovationLog

    picture = None if out is None else check_picture(out)
    require(not (picture and spoofer), "--out draws families of attacks: leave out --spoofer")
    found = attack_log(
        InnovationLog.load(log),
        opt.parse_specs(detector),
        false_alarms_per_hour,
        attack_s=attack_s,
        time_to_alert_s=time_to_alert_s,
        heading_deg=heading_deg,
        rate_limit_mps=rate_limit_mps,
        spoofers=opt.parse_specs(spoofer or ()),
        threads=threads,
    )
    results = [{**x.as_json(), "detector": t} for t, x in zip(detector, found, strict=True)]
    rows = [{**each, "detector": x["detector"]} for x in results for each in x["families"]]
    if picture is not None:
        lines: dict[str, list[Dot]] = {}
        for row in rows:
            series = f"{row['detector']}, {100.0 * row['budget']:.2g} % alarm"
            lines.setdefault(row["family"], []).append(Dot(series, row[MOVED], not row["at_limit"]))
        dots = [DotRow(family, own) for family, own in lines.items()]
        save_drawing(draw_dots(dots, "undetected displacement [m]"), dots_height(dots), picture)
    if as_json:
        print_json(results)
        return
    for each in results:
        print_lines(
            [
                f"{each['detector']}: {each['windows']} windows of {each['window_s']:g} s, "
                f"{each['clean_alarms']} with an alarm before or without an attack, left out; "
                f"factor on the threshold {each['factor']:.3g}"
            ]
        )
    if spoofer:
        played = [{**each, "detector": x["detector"]} for x in results for each in x["played"]]
        Table(
            ("detector", "detector"),
            ("attack", "spoofer"),
            ("windows that alarm [%]", lambda r: percent(r["alarm_rate"])),
            ("unseen displacement [m]", lambda r: interval(r[MOVED])),
        ).print("what spoofers reach", played)
        return
    Table(
        ("detector", "detector"),
        ("attack", "family"),
        ("windows that alarm [%]", lambda r: f"{100.0 * r['budget']:.2g}"),
        ("amplitude", lambda r: f"{interval(r['amplitude'])} {r['unit']}{_mark_end(r)}"),
        ("unseen displacement [m]", lambda r: interval(r[MOVED])),
    ).print("what attacks reach", rows)
    bounds = ((each["detector"], each["zero_alarm"]) for each in results)
    print_lines(f"{name}: no attack without an alarm exceeds {_say(x)}" for name, x in bounds)
    print_written([] if picture is None else [picture])


def _mark_end(row: dict[str, Any]) -> str:
    return " (limit)" if row["at_limit"] else "" if row["within_range"] else " (or less)"


def _say(bound: dict[str, Any]) -> str:
    value = bound["restricted_m"]
    if value is None:
        return f"a distance that is not known: {bound['why']}"
    return value if isinstance(value, str) else f"{value:.3g} m in the mean"


@group.command("import")
@clear_errors
def import_log(
    files: list[Path] = Argument(
        help="Log of PX4 (.ulg) or ArduPilot (.bin), a table (.csv, .parquet) or matrices "
        "(.npz, .mat); or raw measurements: observations (RINEX 2 or 3, or a table of "
        "RXM-RAWX), navigation files (RINEX), and a table of inertial samples."
    ),
    out: Path = Option(..., "--out", "-o", help="File to write, .npz or .csv."),
    mapping: Path | None = Option(
        None, help="TOML file that says what the columns of the inertial samples are."
    ),
    static: bool = Option(False, "--static", help="The receiver was at rest; no inertial samples."),
    grade: str = Option("consumer", help="Grade of the inertial sensors."),
    noise_factors: tuple[float, float] = Option(
        (1.0, 1.0),
        help="Factors on the standard deviations of pseudoranges and range rates: the "
        "receiver's own, or 2.5 m and 0.1 m/s if it states none.",
    ),
    keep_odd: bool = Option(
        False,
        "--keep-odd",
        help="Keep satellites whose ranges disagree by over 500 m in the log, for tests of "
        "ranges: the filter does not use them.",
    ),
    as_json: opt.Json = False,
) -> None:
    """Write a log of innovations, from an autopilot's log, or from raw measurements by running a
    filter over them. Or convert such a log to its other form, table or matrices."""
    from ..receiver.autopilots import read_dataflash, read_ulog
    from ..receiver.log import InnovationLog, check_written
    from ..receiver.raw_measurements import read_raw_log

    check_written(out)
    raw = len(files) > 1 or mapping is not None or static
    require(
        (raw or (noise_factors == (1.0, 1.0) and not keep_odd))
        and ((raw and not static) or grade == "consumer"),
        "--noise-factors and --keep-odd are for raw measurements, --grade is for those with "
        "inertial samples",
    )
    if raw:
        noise = {"noise_factors": noise_factors, "keep_odd": keep_odd}
        found = read_raw_log(files, mapping, static=static, grade=grade, **noise)
    else:
        readers = {".ulg": read_ulog, ".bin": read_dataflash}
        found = readers.get(files[0].suffix.lower(), InnovationLog.load)(files[0])
    if as_json:
        signals = [each._asdict() for each in found.check_signals()]
        written = str(found.save(out))
        print_json({**_count(found), "about": found.about, "signals": signals, "written": written})
        return
    print_lines(_describe_import(found))
    print_written([found.save(out)])


def _count(log: InnovationLog) -> dict[str, Any]:
    return {
        "epochs": len(log.time),
        "duration_s": round(log.duration_s, 3),
        "interval_s": round(log.interval_s, 6),
        "segments": len(set(log.segment.tolist())),
        "channels": list(log.channels),
    }


def _describe_size(log: InnovationLog) -> str:
    size = _count(log)
    return (
        f"{size['epochs']} epochs in {size['segments']} segments, {log.duration_s:.6g} s, one "
        f"every {log.interval_s:.6g} s, of {len(log.channels)} channels"
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
    return [*lines, f"used: {_describe_size(log)}; median NIS {', '.join(medians)}"]
