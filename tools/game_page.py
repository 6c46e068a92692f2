"""Tables of `docs/game.md`, from the results of a game of `train.double_oracle`.

    python -m tools.game_page runs/game

takes them into `docs/game.json`, and writes the tables of the page; without a folder it writes the
tables again.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from agents.folder import error_lines
from agents.game_page import shown, taken
from spoofgym.core.files import write_file

from .pages import put_between

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE, KEPT = DOCS / "game.md", DOCS / "game.json"
BEGIN, END = "<!-- game:begin -->", "<!-- game:end -->"


def main() -> None:
    """Take the results of a folder, if one is given, and write the page."""
    with error_lines():
        for folder in sys.argv[1:2]:
            results = json.loads((Path(folder) / "results.json").read_text(encoding="utf-8"))
            write_file(KEPT, (json.dumps(taken(results), indent=1) + "\n").encode())
        put_between(PAGE, BEGIN, END, shown(json.loads(KEPT.read_text(encoding="utf-8"))))


if __name__ == "__main__":
    main()
