"""Tables of `docs/double_oracle.md`, of a `train.double_oracle`: ``tools.game_page runs/game``."""

from __future__ import annotations

import json

from agents.folder import error_lines, write_json
from agents.game_page import select_results, shown

from .pages import DOCS, fit_tables, parse_folders, put_between

PAGE, DATA_FILE = DOCS / "double_oracle.md", DOCS / "game.json"
START, END = "<!-- game:begin -->", "<!-- game:end -->"


@error_lines()
def main() -> None:
    for folder in parse_folders("Write the page of games.")[:1]:
        write_json(DATA_FILE, select_results(json.loads((folder / "results.json").read_text())))
    put_between(PAGE, START, END, fit_tables(shown(json.loads(DATA_FILE.read_text()))))


if __name__ == "__main__":
    main()
