"""Pages of the papers in docs: ``python -m baselines.papers.page``.

A page is made of the texts of a paper's module, and of the JSON file and the pictures with it,
which are made from a stored full run: ``python -m baselines.papers all`` first.  Beside it lie all
rows as CSV, where their bands come from, and a picture of what is printed and what is ours.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from spoofgym import __version__
from spoofgym.cli import clear_errors
from spoofgym.core.files import whole_file, write_file
from spoofgym.core.plots import BLUE, GREY, ORANGE, figure_class, save_figure, style
from spoofgym.core.reading import read_json

from .frame import Paper, Settings
from .paper import ALL, KEYS, load_paper
from .run import Data, PaperRun
from .tables import COUNTS, HEAD, by_table, cells, count, counts_text

DOCS = Path(__file__).resolve().parents[2] / "docs" / "papers"
FIGURES = "figures"
"""Folder of the pictures, within that of the pages."""
VERSIONS = ("python", "numpy", "scipy", "numba")
MOST_ROWS = 10
"""Of a table of a page."""
PARTS = "table", "rows", *(name.replace("_", " ") for name in COUNTS), "without a band"
SHARE, COUNT = "share", "count"
PANELS = {"[s]": "times [s]", "[m]": "errors and thresholds [m]", "%": "shares [%]"}
PANELS |= {SHARE: PANELS["%"], COUNT: "counts"}
"""Panels of the picture of all rows, by the unit of a quantity; a share is shown in per cent."""
VALUES = "paper", "ours"
MOST_LINEAR = 300.0
"""Largest value over the smallest, beyond which an axis is logarithmic."""
LOOKS: dict[str, dict[str, Any]] = {
    "band": {"color": GREY, "lw": 3, "alpha": 0.4, "solid_capstyle": "butt", "zorder": 1},
    "ours": {"color": BLUE, "marker": "o", "ms": 3.5, "ls": "none"},
    "ours, not met": {"color": ORANGE, "marker": "o", "ms": 3.5, "ls": "none"},
    "as printed": {"color": "black", "marker": "x", "ms": 5, "ls": "none"},
}
app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command()
@clear_errors
def main(
    key: Annotated[str, typer.Argument(help=f"{', '.join(KEYS)}; or all of them.")] = ALL,
    out: Annotated[Path, typer.Option(help="Folder with the stored runs.")] = Path(
        "results/papers"
    ),
    docs: Annotated[Path, typer.Option(help="Folder of the pages.")] = DOCS,
    seed: Annotated[int, typer.Option(help="Seed of the stored runs.")] = 0,
    texts_only: Annotated[
        bool,
        typer.Option(
            "--texts-only", help="Keep the JSON files, and write the pages anew from them."
        ),
    ] = False,
) -> None:
    """Write the page of a paper, and the JSON file that it is made of, from a stored full run."""
    for each in KEYS if key == ALL else (key,):
        paper = load_paper(each)
        path = docs / f"{each}.json"
        if texts_only:
            stored = read_json(path)
        else:
            run = PaperRun(each, Settings(quick=False, seed=seed), out)
            data = run.load_data()
            pictures = [small_picture(path) for path in run.draw(data, docs / FIGURES)]
            stored = page_record(run, data, [path.name for path in pictures])
            content = json.dumps(stored, indent=1, allow_nan=False) + "\n"
            write_file(path, content.encode())
        page = path.with_suffix(".md")
        for name, content in list_files(stored).items():
            write_file(docs / name, content.encode())
        draw_rows(stored["rows"], path.with_suffix(".png"))
        write_file(page, page_text(paper, stored).encode())
        typer.echo(f"written: {page}")


def small_picture(path: Path, colours: int = 64) -> Path:
    """Store a picture of lines with few colours, at a quarter of its size."""
    from PIL import Image

    with Image.open(path) as picture:
        few = picture.convert("RGB").quantize(colours, dither=Image.Dither.NONE)
    with whole_file(path) as part:
        few.save(part, format="PNG", optimize=True)
    return path


def page_record(run: PaperRun, data: Data, pictures: list[str]) -> dict[str, Any]:
    """What a page tells of a run, with the names of the files in the folder of the figures."""
    code = run.store.config["code"]
    return {
        **run.record(data),
        "pictures": pictures,
        "versions": {"spoofgym": __version__, **{name: code[name] for name in VERSIONS}},
        "parts": len(run.parts),
    }


def list_files(stored: Mapping[str, Any]) -> dict[str, str]:
    """CSV files beside a page, by name: all rows, and where their bands come from."""
    rows = [[name, *cells(row)] for name, own in by_table(stored["rows"]).items() for row in own]
    bands = [[letter, each["kind"], each["text"]] for letter, each in stored["origins"].items()]
    key = stored["paper"]
    return {
        f"{key}.csv": _csv(("table", *HEAD), rows),
        f"{key}_bands.csv": _csv(("band", "kind", "where it comes from"), bands),
    }


def _csv(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows([head, *rows])
    return buffer.getvalue()


def read_unit(row: Mapping[str, Any]) -> str:
    """Panel of a row, by the unit of its quantity; "" for one with another unit."""
    found = [unit for unit in PANELS if unit in row["quantity"]]
    if found or "[" in row["quantity"]:
        return found[0] if found else ""
    return SHARE if max(row["paper"], row["ours"]) <= 1.0 else COUNT


def draw_rows(rows: Iterable[Mapping[str, Any]], path: Path) -> Path:
    """Every row with a printed value and a band: crosses as printed, dots ours."""
    panels: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        if row["printed_inside"] is not None and row["ours"] is not None and read_unit(row):
            panels.setdefault(PANELS[read_unit(row)], []).append(row)
    figure = figure_class()(figsize=(4.2 * max(len(panels), 1), 3.4), layout="constrained", dpi=110)
    axes = figure.subplots(1, max(len(panels), 1), squeeze=False)[0]
    for ax, (title, own) in zip(axes, sorted(panels.items()), strict=False):
        style(ax)
        _draw_panel(ax, sorted(own, key=lambda row: row["paper"]))
        ax.set(title=title, xlabel="rows, by their printed value", xticks=[])
    for name, look in LOOKS.items():
        axes[0].plot([], [], label=name, **look)
    figure.legend(loc="outside lower center", ncols=2 * len(axes), frameon=False)
    return save_figure(figure, path)


def _draw_panel(ax: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    scale = [100.0 if read_unit(row) == SHARE else 1.0 for row in rows]
    every = [
        factor * abs(row[name]) for row, factor in zip(rows, scale, strict=True) for name in VALUES
    ]
    shares = {read_unit(row) for row in rows} <= {SHARE, "%"}
    if not shares and max(every) > MOST_LINEAR * min((x for x in every if x > 0.0), default=1.0):
        ax.set_yscale("symlog", linthresh=1.0)
        ax.yaxis.set_major_formatter("{x:g}")
    bare = []
    for k, (row, factor) in enumerate(zip(rows, scale, strict=True)):
        printed, ours = (factor * row[name] for name in VALUES)
        bare.append((k, printed, ours, bool(row["printed_inside"])))
        ends = [None if row[name] is None else factor * row[name] for name in ("low", "high")]
        if None not in ends:
            ax.plot([k, k], ends, **LOOKS["band"])
    for met, name in ((True, "ours"), (False, "ours, not met")):
        shown = [(k, ours) for k, _, ours, each in bare if each is met]
        ax.plot([k for k, _ in shown], [ours for _, ours in shown], **LOOKS[name])
    ax.plot([k for k, *_ in bare], [printed for _, printed, *_ in bare], **LOOKS["as printed"])


def page_text(paper: Paper, stored: dict[str, Any]) -> str:
    """Page of a paper."""
    key, rows = stored["paper"], stored["rows"]
    seed = f" --seed {stored['seed']}" if stored["seed"] else ""
    time = f", {stored['seconds']} s of one core" if "seconds" in stored else ""
    computed = ", ".join(f"{name} {version}" for name, version in stored["versions"].items())
    lines = [
        f"# {paper.TITLE}",
        "",
        f"`{key}` in the [bibliography](../bibliography.md). `python -m baselines.papers.page` "
        f"makes this page; its texts are in `baselines.papers.{key}`.",
        "",
        "## What the paper claims",
        "",
        paper.CLAIMS.strip(),
        "",
        "## What we found",
        "",
        paper.FINDINGS.strip(),
        "",
        *(f"- {line}" for line in counts_text(rows)),
        "",
        f"![Printed values as crosses, ours as dots, bands in grey]({key}.png)",
        "",
        "## Readings",
        "",
        paper.READINGS.strip(),
        "",
        "## Tables",
        "",
        f"All rows are in [{key}.csv]({key}.csv), where their bands come from in "
        f"[{key}_bands.csv]({key}_bands.csv). [How to read them](../papers.md#how-to-read-a-row).",
        "",
    ]
    counted = [_count_table(name, own) for name, own in by_table(rows).items()]
    for first in range(0, len(counted), MOST_ROWS):
        some = counted[first : first + MOST_ROWS]
        lines += [_line(PARTS), _line(["---"] * len(PARTS)), *map(_line, some), ""]
    lines += ["## Figures", "", "Drawn from our runs; the numbers are those of the paper.", ""]
    for name in stored["pictures"]:
        number = int(re.findall(r"[0-9]+", name)[-1])
        lines += [f"![Figure {number}, drawn from our runs]({FIGURES}/{name})", ""]
    lines += [
        "## How it was run",
        "",
        "```console",
        f"python -m baselines.papers {key}{seed}",
        "```",
        "",
        f"Random seed {stored['seed']}, {stored['runs']} simulated runs in {stored['parts']} parts"
        f"{time}; {computed}.",
    ]
    return "\n".join(lines) + "\n"


def _count_table(name: str, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """A table of a paper under `PARTS`."""
    told = [count(rows, verdict) for verdict in COUNTS]
    shown = [f"{yes} of {every}" if every else "-" for yes, every in told]
    rest = sum(row["origin"] is None for row in rows)
    return [_cell(name), str(len(rows)), *shown, str(rest)]


def _line(texts: Any) -> str:
    return f"| {' | '.join(texts)} |"


def _cell(text: str) -> str:
    """Text that breaks no table."""
    return text.replace("|", "\\|").replace("\n", " ")


if __name__ == "__main__":
    app()
