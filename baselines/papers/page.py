"""Pages of the papers in docs: ``python -m baselines.papers.page``.

A page is made of the texts of a paper's module and of the JSON file beside it, which is made of a
stored full run: ``python -m baselines.papers all`` first.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from spoofgym._files import write_file
from spoofgym.cli import clear_errors

from .frame import Paper, Settings
from .paper import ALL, KEYS, load_paper
from .run import PaperRun, Reproduction, versions
from .tables import HEAD, by_table, cells, verdict

DOCS = Path(__file__).resolve().parents[2] / "docs" / "papers"

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
            stored = json.loads(path.read_text(encoding="utf-8"))
        else:
            run = PaperRun(each, Settings(quick=False, seed=seed), out)
            stored = page_record(run.result())
            content = json.dumps(stored, indent=1, allow_nan=False) + "\n"
            write_file(path, content.encode())
        page = path.with_suffix(".md")
        write_file(page, page_text(paper, stored).encode())
        typer.echo(f"written: {page}")


def page_record(reproduction: Reproduction) -> dict[str, Any]:
    """What a page tells of a run.

    Parameters
    ----------
    reproduction : Reproduction
        A full one.

    Returns
    -------
    dict
        As `Reproduction.record`, with versions, parts and their processor time.
    """
    told = [each["versions"] for each in reproduction.told]
    names = sorted({name for each in told for name in each})
    found = {name: sorted({each[name] for each in told if name in each}) for name in names}
    return {
        **reproduction.record(),
        "versions": {name: ", ".join(found[name]) for name in versions()},
        "parts": len(reproduction.parts),
        "seconds": round(sum(each["seconds"] for each in reproduction.told)),
    }


def page_text(paper: Paper, stored: dict[str, Any]) -> str:
    """Page of a paper.

    Parameters
    ----------
    paper : Paper
        Has the texts.
    stored : dict
        Of `page_record`.

    Returns
    -------
    str
        Markdown.
    """
    key, rows = stored["paper"], stored["rows"]
    seed = f" --seed {stored['seed']}" if stored["seed"] else ""
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
        paper.FOUND.strip(),
        "",
        verdict(rows),
        "",
        "## Readings",
        "",
        paper.READINGS.strip(),
        "",
        "## Tables",
        "",
    ]
    for name, members in by_table(rows).items():
        lines += [f"### {_cell(name)}", "", _line(HEAD), _line(["---"] * len(HEAD))]
        lines += [_line(map(_cell, cells(row))) for row in members]
        lines.append("")
    lines += [
        "## How it was run",
        "",
        "```console",
        f"python -m baselines.papers {key}{seed}",
        "```",
        "",
        f"Seed {stored['seed']}, {stored['runs']} simulated runs in {stored['parts']} parts, "
        f"{stored['seconds']} s of one core; {computed}.",
    ]
    return "\n".join(lines) + "\n"


def _line(texts: Any) -> str:
    return f"| {' | '.join(texts)} |"


def _cell(text: str) -> str:
    """Text that breaks no table."""
    return text.replace("|", "\\|").replace("\n", " ")


if __name__ == "__main__":
    app()
