"""Pages of the papers in docs: ``python -m baselines.papers.page``.

A page is made of the texts of a paper's module, and of the JSON file and the pictures with it,
which are made from a stored full run: ``python -m baselines.papers all`` first.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Any

import typer

from spoofgym import __version__
from spoofgym.cli import clear_errors
from spoofgym.core.files import whole_file, write_file
from spoofgym.core.reading import read_json

from .frame import Paper, Settings
from .paper import ALL, KEYS, load_paper
from .run import Data, PaperRun
from .tables import HEAD, by_table, cells, counts_text

DOCS = Path(__file__).resolve().parents[2] / "docs" / "papers"
FIGURES = "figures"
"""Folder of the pictures, within that of the pages."""
VERSIONS = ("python", "numpy", "scipy", "numba")
LEGEND = """\
Every band says where it comes from, by its letter. A *tolerance* is a margin around the printed
value, or the spread of our own runs; an *independent* band is around what a second program found,
which was written separately from the same paper and is not part of this repository: often one
standard deviation of single runs, ours or its own, to either side of its median, a coarse check; a
*bound* is a limit from theory or of our own.

- *printed inside*: the printed value and ours both lie in the band. Where the band excludes the
  printed value it is NO, wherever ours lies.
- *agrees*: ours lies in the band of the independent implementation.
- *kept*: ours lies within the bound.

Under *paper*, 1 and 0 stand for what the paper claims of all or of none in words."""

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


def page_text(paper: Paper, stored: dict[str, Any]) -> str:
    """Page of a paper."""
    key, rows = stored["paper"], stored["rows"]
    seed = f" --seed {stored['seed']}" if stored["seed"] else ""
    time = f", {stored['seconds']} s of one core" if "seconds" in stored else ""
    computed = ", ".join(f"{name} {version}" for name, version in stored["versions"].items())
    lines = [
        f"# {paper.TITLE}",
        "",
        f"Key in `references.bib`: `{key}`. This page and `{key}.json` are made by "
        "`python -m baselines.papers.page`; edit the texts in the module "
        f"`baselines.papers.{key}`.",
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
        "## Readings",
        "",
        paper.READINGS.strip(),
        "",
        "## Where the bands come from",
        "",
        LEGEND,
        "",
        *(
            f"- **{letter}** ({origin['kind']}): {origin['text']}"
            for letter, origin in stored["origins"].items()
        ),
        "",
        "## Tables",
        "",
    ]
    for name, members in by_table(rows).items():
        lines += [f"### {_cell(name)}", "", _line(HEAD), _line(["---"] * len(HEAD))]
        lines += [_line(map(_cell, cells(row))) for row in members]
        lines.append("")
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
        f"Seed {stored['seed']}, {stored['runs']} simulated runs in {stored['parts']} parts{time}; "
        f"{computed}.",
    ]
    return "\n".join(lines) + "\n"


def _line(texts: Any) -> str:
    return f"| {' | '.join(texts)} |"


def _cell(text: str) -> str:
    """Text that breaks no table."""
    return text.replace("|", "\\|").replace("\n", " ")


if __name__ == "__main__":
    app()
