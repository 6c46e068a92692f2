"""The versions that docs/promises.md says are tested are those that these tests run with."""

from importlib.metadata import PackageNotFoundError, version

from tools.pages import part_between
from tools.versions import MARKS, PACKAGES, PAGE, make_table, read_versions


def test_the_table_is_made_of_the_constraints():
    assert part_between(PAGE.read_text(), *MARKS) == f"\n{make_table()}"


def test_what_is_installed_is_what_the_table_says():
    here = read_versions("constraints.txt")
    if version("gymnasium") != here["gymnasium"]:  # in the environment of `make test-ray`
        here = read_versions("constraints-ray.txt")
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name).partition("+")[0]
        except PackageNotFoundError:
            continue
    assert len(found) >= 5
    assert {name: here[name] for name in found if name in here} == {
        name: each for name, each in found.items() if name in here
    }
