"""The list of docs/bibliography.md, from references.bib: ``python -m tools.bibliography``."""

from __future__ import annotations

import re

from tools.pages import DOCS, ROOT, marks, put_between

PAGE, MARKS = DOCS / "bibliography.md", marks("bibliography")
WHERE = "journal", "booktitle", "publisher", "institution", "howpublished"
"""Fields that say where a work appeared; the first that it has."""
ACCENTS = {r"\'a": "á", r"\'e": "é", r"\'i": "í", r"\'o": "ó", r"\`e": "è", r"\&": "&", "--": "-"}


def read_works() -> dict[str, dict[str, str]]:
    """Fields of every work, by its key, as plain text."""
    works = {}
    text = (ROOT / "references.bib").read_text()
    for key, body in re.findall(r"^@\w+\{([^,]+),\n(.*?)^\}", text, flags=re.M | re.S):
        fields = re.findall(r"^  (\w+) *= \{(.*?)\},$", body, flags=re.M | re.S)
        works[key] = {name: read_plain(value) for name, value in fields}
    return works


def read_plain(value: str) -> str:
    for mark, letter in ACCENTS.items():
        value = value.replace(mark, letter)
    return " ".join(re.sub(r"\\url|[{}$]|Proceedings of the ", "", value).split())


def describe_authors(text: str) -> str:
    """Family names, of more than two that of the first."""
    names = [name.partition(",")[0] for name in text.split(" and ")]
    return f"{names[0]} et al." if len(names) > 2 else " and ".join(names)


def describe(key: str, work: dict[str, str]) -> str:
    """One line, with a link where the work has an address."""
    where = next((work[name] for name in WHERE if name in work), "")
    link = f"https://doi.org/{work['doi']}" if "doi" in work else ""
    if "eprint" in work:
        link, where = f"https://arxiv.org/abs/{work['eprint']}", "arXiv"
    elif where.startswith("http"):
        link, where = where, "recording"
    title = f"[{work['title']}]({link})" if link else work["title"]
    authors = describe_authors(work["author"]) if "author" in work else ""
    parts = (authors, title, where if where != authors else "", work.get("year"))
    return f"- `{key}`: {', '.join(filter(None, parts))}"


def build_list() -> str:
    works = read_works()
    return "\n".join(describe(key, works[key]) for key in sorted(works)) + "\n"


if __name__ == "__main__":
    put_between(PAGE, *MARKS, build_list())
