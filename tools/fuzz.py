"""Damaged and hostile files for every reader: `python -m tools.fuzz --cases 1000`.

Each case is a file of a small corpus after some mutations, drawn from its number. It is read in a
child process with limits of memory and time. A reader either refuses it by a `ValueError` of one
line or reads it, and then what was read must pass the check that is stated beside the reader.
"""

from __future__ import annotations

import gzip
import io
import json
import os
import re
import resource
import signal
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer

from spoofgym.bench.experiments.store import Cell, Result, Store
from spoofgym.core.files import write_file
from spoofgym.core.reading import read_json
from spoofgym.core.registry import parse_spec
from spoofgym.data.inertial import read_inertial
from spoofgym.data.observations import SDS, TABLE, read_observations
from spoofgym.data.rinex import read_navigation
from spoofgym.data.tracks import read_track
from spoofgym.detectors.build import make_detector
from spoofgym.detectors.calibration_file import SHIPPED_FOLDER, Calibration
from spoofgym.envs.terms import make_terms
from spoofgym.policies import DetectorCard, load_card
from spoofgym.policies.card import Card
from spoofgym.policies.onnx_file import read_model
from spoofgym.policies.onnx_model import OnnxModel
from spoofgym.policies.zoo import ZOO_FOLDER
from spoofgym.receiver.autopilots import read_dataflash, read_ulog
from spoofgym.spoofers import make_spoofer
from spoofgym.truth.scenario import make_scenario
from tools.autopilot_logs import fly, fly_ardupilot, write_dataflash, write_ulog

MEMORY, LIMIT_S, LARGEST_GROWTH = 3 << 30, 5, 500 << 20
"""Of the address space of a child [bytes], of a case [s], and of its memory in use [bytes]."""
NASTY = (*(0, -1, 1e308, -1e-308, 2**63, 10**400, 1e999, float("nan")), None, True, "", "\ud800")
NASTY = (*NASTY, "x" * 10**5, [], {}, [[]] * 1000, {"name": "x"}, "../x", "NaN", -0.0)
TOKENS = (b"NaN", b"1e999", b"9" * 400, b"[" * 5000, b'{"a":' * 500, b"\x00" * 64, b"\xff\xfe")
TOKENS = (*TOKENS, b"\n" * 5000, b"," * 5000, b"\r", b'"', b"-", b"\xe2\x80\xa8", b"\\ud800", b"=")
NUMBERS = (b"0", b"-1", b"1e308", b"-1e308", b"1e-308", b"9" * 400, b"nan", b"inf", b"1e999")
NUMBERS = (*NUMBERS, b"3", b"-0.0", b"2147483648", b"[1,2]", b"none", b"true", b"x", b"0.5")
RECORD = """\
 5 24  9 14 22  0  0.0-0.150000000000D-03-0.250000000000D-11 0.000000000000D+00
    0.630000000000D+02-0.900000000000D+02 0.460000000000D-08 0.700000000000D+00
   -0.400000000000D-05 0.120000000000D-01 0.550000000000D-05 0.515370000000D+04
    0.597600000000D+06 0.300000000000D-07 0.230000000000D+01-0.900000000000D-07
    0.965000000000D+00 0.275000000000D+03-0.190000000000D+01-0.810000000000D-08
    0.200000000000D-09 0.100000000000D+01 0.233100000000D+04 0.000000000000D+00
    0.200000000000D+01 0.000000000000D+00-0.110000000000D-07 0.630000000000D+02
    0.590400000000D+06 0.400000000000D+01
"""
NAVIGATION = f"{'     2.10':20}{'N':40}RINEX VERSION / TYPE\n{'':60}END OF HEADER\n{RECORD}{RECORD}"
OBSERVATIONS = (
    f"{'     3.04':20}{'O':40}RINEX VERSION / TYPE\n{'G    2 C1C D1C':60}SYS / # / OBS TYPES\n"
    f"{'':60}END OF HEADER\n"
    + "".join(
        f"> 2024 09 14 22 00 {k:10.7f}  0  1\nG05{2e7:14.3f}  {9e2:14.3f}\n" for k in range(9)
    )
)
RAW = "\n".join([",".join((*TABLE, *SDS)), *(f"2331,{k},0,5,0,2e7,900,1,1" for k in range(9))])
SAMPLES = b"".join(b"%d,0,0,-1,0,0,0\n" % k for k in range(9))
MAPPING = b"""header = false
time = { column = 1, unit = "s", scale = "gps" }
specific_force = { columns = [2, 3, 4], unit = "g" }
angular_rate = { columns = [5, 6, -7], unit = "deg/s" }
"""
ROWS = [
    {"time": 1.7e9 + 5 * k, "lat": 47.0 + 1e-3 * k, "lon": 8.0, "alt": 1e4, "gs": 400, "track": 1}
    for k in range(20)
]
SETTINGS = {
    make_detector: (
        *("ewma:smoothing=0.2,max_exclusion_s=60", "snapshot-chi2:false_alarm=0.01", "raim"),
        *("cusum", "aime:windows_s=[5,25],signals=both", '{"name": "ewma", "smoothing": 0.1}'),
    ),
    make_spoofer: ("ramp:rate_mps=0.2,heading_deg=90", "none", "step:size_m=5"),
    make_scenario: (
        *("zhong2025:epoch_interval_s=0.5", "zhong2025:imu_rate_hz=20,mask_deg=5"),
        *("ke2022:channels=8", "zhong2025:events=none"),
    ),
}


class Reader(NamedTuple):
    """`corpus`: whole files; `read`: one of them; raises where what was read is nonsense."""

    suffix: str
    corpus: Callable[[], list[bytes]]
    read: Callable[[Path], Any]


def _write(name: str, fill: Callable[[Path], Any]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        fill(Path(folder) / name)
        (path,) = (each for each in Path(folder).rglob("*") if each.is_file() and name in each.name)
        return path.read_bytes()


def _open_store(path: Path) -> Store:
    store = Store(path)
    store.open("fuzz", {"a": 1})
    return store


def _store_cell() -> list[bytes]:
    result = Result({"x": np.zeros(5), "y": np.arange(6).reshape(2, 3)}, {"a": 1.0}, {"f": b"1"})
    put = lambda path: _open_store(path.parent).put(Cell("cell", {}), result)  # noqa: E731
    return [_write("cell.npz", put)]


def _read_cell(path: Path) -> None:
    store = _open_store(path.parent / "store")
    write_file(store.build_path("cell"), path.read_bytes())
    found = store.get(Cell("cell", {}))
    assert found is not None
    json.dumps(found.record, allow_nan=False)


def _read_config(path: Path) -> None:
    store = Store(path.parent / "config")
    write_file(store.path / "config.json", path.read_bytes())
    json.dumps(store.reopen(), allow_nan=False)


def _parquet() -> list[bytes]:
    import pandas

    return [_write("x.parquet", pandas.DataFrame(ROWS).to_parquet)]


def _read_track(path: Path) -> None:
    track = read_track(path)
    assert (np.diff(track.time) >= 0.0).all()
    assert not (np.abs(track.latitude) > np.pi / 2).any()


def _read_navigation(path: Path) -> None:
    found = read_navigation(path)
    assert all(np.isfinite(x).all() for k, x in vars(found).items() if k != "satellite_id")


def _flights() -> list[bytes]:
    flights = [fly(seconds=12.0, old=old)[0] for old in (False, True)]
    return [_write("x.ulg", partial(write_ulog, topics=topics)) for topics in flights]


def _dataflash() -> list[bytes]:
    return [_write("x.bin", partial(write_dataflash, rows=fly_ardupilot(seconds=12.0)[0]))]


def _read_flight(path: Path) -> None:
    """A log has checked itself; what is said of it must be printable."""
    log = read_ulog(path) if path.suffix == ".ulg" else read_dataflash(path)
    json.dumps([*log.check_signals(), log.about], allow_nan=False)


def _read_observations(path: Path) -> None:
    found = read_observations(path)
    assert np.isfinite(found.time).all()
    assert found.pseudorange.shape == (len(found.time), len(found.satellites))


def _read_samples(path: Path) -> None:
    (path.parent / "m.toml").write_bytes(MAPPING)
    found = read_inertial(path, path.parent / "m.toml", 0.0)
    assert all(np.isfinite(x).all() for x in found[:3])


def _read_mapping(path: Path) -> None:
    (path.parent / "s.csv").write_bytes(SAMPLES)
    read_inertial(path.parent / "s.csv", path, 0.0)


def _read_onnx(path: Path) -> None:
    content = path.read_bytes()
    about = _describe(content)
    read_model(content, str(path))
    recurrent = load_card("window-guard", DetectorCard)
    OnnxModel(path, about, 2, recurrent.state)._open()


def _describe(content: bytes) -> Any:
    from hashlib import sha256

    from spoofgym.policies.card import PolicyFile

    return PolicyFile(
        name="x.onnx", sha256=sha256(content).hexdigest(), bytes=max(len(content), 1), opset=1
    )


def _read_calibration(path: Path) -> None:
    found, (whole,) = Calibration.load(path), _calibrations()
    mine, content = json.loads(whole), read_json(path)
    both = mine.keys() & content.keys() - {"checksum"}
    changed = [key for key in both if mine[key] != content[key]]
    assert "checksum" not in content or not changed, f"{changed} {found.runs}"


def _read_settings(path: Path) -> None:
    """The first digit of a text says what it is of."""
    number, text = path.read_bytes()[:1], path.read_bytes()[1:].decode(errors="replace")
    makers = list(SETTINGS)
    makers[int(number) if number in (b"0", b"1", b"2") else 0](parse_spec(text))


def _settings() -> list[bytes]:
    texts = enumerate(SETTINGS.values())
    return [f"{k}{text}".encode() for k, some in texts for text in some]


def _read_checkpoint(path: Path) -> None:
    from agents.checkpoint import open_checkpoint

    with open_checkpoint(path) as (_, state):
        json.dumps(state)


def _checkpoints() -> list[bytes]:
    import torch

    from agents.checkpoint import write_checkpoint

    tensors = {"policy": {"w": torch.zeros(3, 2)}}
    return [_write("c.pt", lambda path: write_checkpoint(path, tensors, {"steps": 1}))]


def _read_record(path: Path) -> None:
    from agents.record import read_record

    json.dumps(read_record(path), allow_nan=False)


@cache
def _calibrations() -> list[bytes]:
    paths = sorted(SHIPPED_FOLDER.glob("*/*.json"), key=lambda path: path.stat().st_size)
    return [paths[0].read_bytes()]


def _dump(*values: Any) -> Callable[[], list[bytes]]:
    return lambda: [json.dumps(each).encode() for each in values]


TERMS = {"end": [{"name": "at-displacement", "limit_m": 3.5}, "at-alarm"]}
CSV = "\n".join([",".join(ROWS[0]), *(",".join(map(str, row.values())) for row in ROWS)]).encode()
POINT = {"step": 1, "wall_s": 0.5, "x": None}
READERS = {
    "calibration": Reader(".json", _calibrations, _read_calibration),
    "card": Reader(".json", lambda: [x.read_bytes() for x in ZOO_FOLDER.glob("*.json")], Card.load),
    "checkpoint": Reader(".pt", _checkpoints, _read_checkpoint),
    "config": Reader(".json", _dump({"experiment": "x", "format": 1, "config": {}}), _read_config),
    "dataflash": Reader(".bin", _dataflash, _read_flight),
    "inertial": Reader(".csv", lambda: [SAMPLES], _read_samples),
    "inertial-toml": Reader(".toml", lambda: [MAPPING], _read_mapping),
    "json": Reader(".json", _dump({"a": [1, 2.5, "x", None, {"b": []}]}), read_json),
    "navigation": Reader(".24n", lambda: [NAVIGATION.encode()], _read_navigation),
    "navigation-gz": Reader(
        ".24n.gz", lambda: [gzip.compress(NAVIGATION.encode())], _read_navigation
    ),
    "observations": Reader(".24o", lambda: [OBSERVATIONS.encode()], _read_observations),
    "observations-csv": Reader(".csv", lambda: [RAW.encode()], _read_observations),
    "onnx": Reader(
        ".onnx", lambda: [x.read_bytes() for x in ZOO_FOLDER.glob("*.onnx")], _read_onnx
    ),
    "record": Reader(".jsonl", lambda: [b"\n".join([*_dump(POINT)()] * 3)], _read_record),
    "settings": Reader(".txt", _settings, _read_settings),
    "spoofer": Reader(
        ".json", _dump({"name": "ramp", "rate_mps": 0.2}), lambda path: make_spoofer(str(path))
    ),
    "store": Reader(".npz", _store_cell, _read_cell),
    "terms": Reader(".json", _dump(TERMS), lambda path: make_terms("end", path)),
    "terms-toml": Reader(
        ".toml", lambda: [b'[[end]]\nname = "at-alarm"\n'], lambda path: make_terms("end", path)
    ),
    "track-csv": Reader(".csv", lambda: [CSV, CSV.replace(b",", b";")], _read_track),
    "track-gz": Reader(".csv.gz", lambda: [gzip.compress(CSV)], _read_track),
    "track-json": Reader(
        ".json",
        _dump(
            ROWS,
            {
                "time": 0,
                "states": [["a", "b", "c", 5, 5, 8.0, 47.0, 1e4, False, 200, 1, 0, None, 1e4]],
            },
        ),
        _read_track,
    ),
    "track-parquet": Reader(".parquet", _parquet, _read_track),
}
if find_spec("pyulog"):
    READERS["ulog"] = Reader(".ulg", _flights, _read_flight)


def mutate(content: bytes, rng: np.random.Generator) -> bytes:
    """A file after one to three mutations, within what packs it or as it stands."""
    if content[:2] == b"\x1f\x8b" and rng.random() < 0.7:
        return gzip.compress(mutate(gzip.decompress(content), rng), 1)
    if content[:2] == b"PK" and rng.random() < 0.6:
        return _mutate_member(content, rng)
    if rng.random() < 0.6:
        try:
            return _mutate_json(json.loads(content), rng)
        except (ValueError, RecursionError):
            pass
    numbers = [*re.finditer(rb"-?\d+\.?\d*", content)]
    if numbers and rng.random() < 0.4:
        chosen = numbers[rng.integers(len(numbers))]
        value = NUMBERS[rng.integers(len(NUMBERS))]
        return content[: chosen.start()] + value + content[chosen.end() :]
    for _ in range(rng.integers(1, 4)):
        at, end = np.sort(rng.integers(0, len(content) + 1, 2)).tolist()
        end = min(end, at + int(rng.integers(1, 50)))
        token = TOKENS[rng.integers(len(TOKENS))]
        flipped = bytes(byte ^ int(rng.integers(256)) for byte in content[at : at + 2])
        repeated = content[at:end] * (20 if rng.random() < 0.9 else 1 << 17)
        middle = (flipped + content[at + 2 : end], b"", token, repeated)
        content = content[:at] + middle[rng.integers(len(middle))] + content[end:]
    return content if rng.random() < 0.95 else content[: len(content) // 2]


def _mutate_json(found: Any, rng: np.random.Generator) -> bytes:
    for _ in range(rng.integers(1, 3)):
        node, parent, key = found, None, None
        while isinstance(node, dict | list) and node and (parent is None or rng.random() < 0.7):
            keys = list(node) if isinstance(node, dict) else range(len(node))
            parent, key = node, keys[rng.integers(len(keys))]
            node = node[key]
        if parent is None:
            break
        if rng.random() < 0.2:
            del parent[key]
        else:
            parent[key] = NASTY[rng.integers(len(NASTY))]
    return json.dumps(found).encode()


def _mutate_member(content: bytes, rng: np.random.Generator) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(out, "w") as new:
        names = old.namelist()
        changed = names[rng.integers(len(names))]
        for name in names:
            data = old.read(name)
            new.writestr(name, mutate(data, rng) if name == changed else data)
    return out.getvalue()


def try_case(reader: Reader, corpus: list[bytes], name: str, number: int, folder: Path) -> str:
    """Outcome of a case, read in this process: `read`, `refused`, or what is wrong."""
    rng = np.random.default_rng([number, sum(name.encode())])
    path = folder / f"case{reader.suffix}"
    path.write_bytes(mutate(corpus[rng.integers(len(corpus))], rng))
    start, before = time.monotonic(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        reader.read(path)
        outcome = "read"
    except (ValueError, TypeError, OSError) as error:
        message = str(error)
        message.encode()  # half of a surrogate pair can't be printed
        named = name == "settings" or str(folder) in message
        outcome = "refused" if named else f"no file is named: {type(error).__name__}: {message}"
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        outcome = f"{type(error).__name__} at {Path(last.filename).name}:{last.lineno}: {error}"
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before << 10
    if time.monotonic() - start > LIMIT_S or grown > LARGEST_GROWTH:
        outcome = f"{time.monotonic() - start:.1f} s, {grown >> 20} MB, {outcome}"
    return outcome[:300]


def limit_growth() -> None:
    """Let this process, which may be a fork of a large one, grow by so much and no more."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY, now + MEMORY))


def _run_child(name: str, numbers: range, write: int) -> None:
    """Try cases in this process, which was forked for it; a line for each outcome."""
    limit_growth()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    warnings.simplefilter("ignore")
    reader = READERS[name]
    with tempfile.TemporaryDirectory() as folder, os.fdopen(write, "w", buffering=1) as out:
        corpus = reader.corpus()
        for number in numbers:
            signal.alarm(2 * LIMIT_S)  # which ends the process
            out.write(json.dumps(try_case(reader, corpus, name, number, Path(folder))) + "\n")


def fuzz(name: str, cases: int, seed: int = 0) -> dict[int, str]:
    """Outcomes of cases by number; a child that ends goes on after the case that ended it."""
    found: dict[int, str] = {}
    number, last = seed, seed + cases
    while number < last:
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(read)
            try:
                _run_child(name, range(number, last), write)
            finally:
                os._exit(0)
        os.close(write)
        with os.fdopen(read) as lines:
            for line in lines:
                found[number] = json.loads(line)
                number += 1
        _, status = os.waitpid(child, 0)
        if number < last:
            found[number] = f"its process ended with {status}"
            number += 1
    return found


def main(
    reader: Annotated[list[str] | None, typer.Option(help="Readers. Default: all.")] = None,
    cases: Annotated[int, typer.Option(min=1, help="Cases of each.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Number of the first case.")] = 0,
    out: Annotated[Path | None, typer.Option("--json", help="File of counts and faults.")] = None,
) -> None:
    """Read damaged files by every reader; ends with 1 where one is read in a wrong way."""
    results: dict[str, Any] = {}
    for name in reader or READERS:
        start, found = time.monotonic(), fuzz(name, cases, seed)
        counts = Counter(
            each if each in ("read", "refused") else "faults" for each in found.values()
        )
        faults = {k: each for k, each in found.items() if each not in ("read", "refused")}
        results[name] = {"cases": len(found), **counts, "examples": faults}
        typer.echo(f"{name}: {dict(counts)} in {time.monotonic() - start:.0f} s")
        for each, count in Counter(faults.values()).most_common(5):
            typer.echo(f"  {count} x {each}")
        if out is not None:
            write_file(out, json.dumps(results, indent=1).encode())
    if any(each["examples"] for each in results.values()):
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
