"""The page on the architecture names files and things that exist, and its picture is up to date."""

from __future__ import annotations

import ast
import re
import runpy

from .pages import ROOT, text_of

PAGE = text_of("architecture.md")
SPAN = re.compile(r"`([^`\n]+)`")
PATHS = sorted({span for span in SPAN.findall(PAGE) if re.fullmatch(r"[\w./]*(/|\.py)", span)})
ROWS = [line for line in PAGE.splitlines() if line.startswith("|") and ".py`" in line]


def places(path):
    """Where a path of the page may be: in the package, or in the checkout."""
    return [top / path for top in (ROOT / "spoofgym", ROOT) if (top / path).exists()]


def test_the_picture_is_that_of_the_layers():
    house = runpy.run_path(str(ROOT / "docs" / "house.py"))
    assert (ROOT / "docs" / "house.svg").read_text() == house["draw"]()


def test_the_paths_of_the_page_exist():
    assert [path for path in PATHS if not places(path)] == []


def test_what_a_row_names_is_in_a_file_of_the_row():
    for row in ROWS:
        spans = SPAN.findall(row)
        files = [place for span in spans for place in places(span) if place.is_file()]
        sources = "\n".join(file.read_text() for file in files)
        for span in spans:
            if re.fullmatch(r"[A-Za-z_.]+", span) and not span.endswith((".py", "/")):
                for name in span.split("."):
                    assert re.search(rf"\b{name}\b", sources), (name, row)


def test_the_files_of_the_flow_of_a_step_exist():
    (flow,) = re.findall(r"```text\n(.*?)```", PAGE, flags=re.DOTALL)
    paths = re.findall(r"(?<=\s)[\w/]+\.py", flow)
    assert len(paths) > 10
    assert [path for path in paths if not places(path)] == []


def only_exports(path):
    """Whether a module has neither a function nor a class of its own."""
    body = ast.parse(path.read_text()).body
    return not any(isinstance(node, ast.FunctionDef | ast.ClassDef) for node in body)


def files_of_the_tree():
    """Paths that docs/tree.md lists, without their `.py`."""
    (block,) = re.findall(r"```text\n(.*?)```", text_of("tree.md"), flags=re.DOTALL)
    folder, found = "", []
    for line in block.splitlines():
        if line.startswith("  "):
            name, words = line.split(maxsplit=1)
            assert words
            found.append(folder + name)
        else:
            assert line.endswith("/")
            folder = line.removeprefix("spoofgym/")
    return found


def test_every_file_of_the_package_stands_in_the_tree_once():
    package = ROOT / "spoofgym"
    found = files_of_the_tree()
    files = {
        str(path.relative_to(package).with_suffix(""))
        for path in package.rglob("*.py")
        if path == package / "__init__.py" or path.name != "__init__.py" or not only_exports(path)
    }
    bare = {name for name in found if name.endswith("/__init__")}  # a registry may be listed, too
    assert len(found) == len(set(found))
    assert set(found) - files <= bare
    assert sorted(files - set(found)) == []


def test_the_rooms_of_the_page_are_the_layers_from_top_to_bottom():
    (table,) = re.findall(r"## The house\n.*?(\| room .*?)\n\n", PAGE, flags=re.DOTALL)
    rooms = [SPAN.search(row)[1] for row in table.splitlines()[2:]]
    rooms = [room.removesuffix(".py").strip("/").split("/")[0] for room in rooms]
    floors = runpy.run_path(str(ROOT / "docs" / "house.py"))["floors"]()
    assert sorted(set(rooms)) == sorted(name for floor in floors for name in floor)
    level = {name: k for k, floor in enumerate(floors) for name in floor}
    assert [level[room] for room in rooms] == sorted(level[room] for room in rooms)
