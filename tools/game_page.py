"""Tables of `docs/game.md`: ``python -m tools.game_page runs/game``, of a `train.double_oracle`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from agents.folder import error_lines, write_json
from agents.game_page import select_results, shown

from .pages import DOCS, put_between

PAGE, DATA_FILE = DOCS / "game.md", DOCS / "game.json"
START, END = "<!-- game:begin -->", "<!-- game:end -->"


@error_lines()
def main() -> None:
    for folder in sys.argv[1:2]:
        write_json(
            DATA_FILE, select_results(json.loads((Path(folder) / "results.json").read_text()))
        )
    put_between(PAGE, START, END, shown(json.loads(DATA_FILE.read_text())))


if __name__ == "__main__":
    main()
