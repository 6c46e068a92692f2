"""The page on the architecture names files and things that exist, and its picture is up to date."""

import ast
import re
import runpy

from .pages import ROOT, text_of

PAGE = text_of("architecture.md")
SPAN = re.compile(r"`([^`\n]+)`")
ROWS = [line for line in PAGE.splitlines() if line.startswith("|") and ".py`" in line]


def places(path):
    """Where a path of the page may be: in the package, or in the checkout."""
    return [top / path for top in (ROOT / "spoofgym", ROOT) if (top / path).exists()]


def test_picture_and_rooms_of_the_page_are_the_layers_from_top_to_bottom():
    house = runpy.run_path(str(ROOT / "docs" / "house.py"))
    assert (ROOT / "docs" / "house.svg").read_text() == house["draw"]()
    part = PAGE.partition("## The house\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `.*", part, flags=re.MULTILINE)
    rooms = [re.match(r"\w+", SPAN.search(row)[1])[0] for row in rows]
    floors, words = house["floors"](), house["ROOMS"]
    for floor in floors:  # no room's words run into the next
        assert all(10 * len(x) + 7.5 * len(words[x]) < 810 / len(floor) for x in floor)
    level = {name: k for k, floor in enumerate(floors) for name in floor}
    assert {*rooms} == {*level}
    assert [level[room] for room in rooms] == sorted(level[room] for room in rooms)


def test_the_paths_of_the_page_exist_and_what_a_row_names_is_in_a_file_of_the_row():
    for row in ROWS:
        spans = SPAN.findall(row)
        files = [place for span in spans for place in places(span) if place.is_file()]
        sources = "\n".join(file.read_text() for file in files)
        for span in spans:
            if re.fullmatch(r"[A-Za-z_.]+", span) and not span.endswith((".py", "/")):
                for name in span.split("."):
                    assert re.search(rf"\b{name}\b", sources), (name, row)
    (flow,) = re.findall(r"```text\n(.*?)```", PAGE, flags=re.DOTALL)  # of a step
    paths = re.findall(r"(?<=\s)[\w/]+\.py", flow)
    assert len(paths) > 10
    spans = [span for span in SPAN.findall(PAGE) if re.fullmatch(r"[\w./]*(/|\.py)", span)]
    assert [path for path in paths + spans if not places(path)] == []


def test_every_file_of_the_package_stands_in_the_tree_once():
    (block,) = re.findall(r"```text\n(.*?)```", text_of("tree.md"), flags=re.DOTALL)
    folder, found = "", []
    for line in block.splitlines():
        if line.startswith("  "):
            name, _ = line.split(maxsplit=1)
            found.append(folder + name)
        else:
            assert line.endswith("/")
            folder = line.removeprefix("spoofgym/")
    package = ROOT / "spoofgym"
    files, bare = set(), set()
    for path in package.rglob("*.py"):
        name = str(path.relative_to(package).with_suffix(""))
        # an `__init__` that only exports may be listed where it is a registry
        own = (ast.FunctionDef, ast.ClassDef)
        exports = not any(isinstance(node, own) for node in ast.parse(path.read_text()).body)
        only = path.name == "__init__.py" and exports and path.parent != package
        (bare if only else files).add(name)
    assert len(found) == len(set(found))
    assert files <= set(found) <= files | bare
