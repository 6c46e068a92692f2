"""Tables of `docs/game.md`: ``python -m tools.game_page runs/game``, of a `train.double_oracle`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from agents.folder import error_lines, write_json
from agents.game_page import shown, taken

from .pages import DOCS, put_between

PAGE, KEPT = DOCS / "game.md", DOCS / "game.json"
BEGIN, END = "<!-- game:begin -->", "<!-- game:end -->"


@error_lines()
def main() -> None:
    for folder in sys.argv[1:2]:
        write_json(KEPT, taken(json.loads((Path(folder) / "results.json").read_text())))
    put_between(PAGE, BEGIN, END, shown(json.loads(KEPT.read_text())))


if __name__ == "__main__":
    main()
