"""A release tries what the README names, and does not keep silent on the rest."""

import tomllib

from tools import release

README = (release.ROOT / "README.md").read_text()


def test_every_command_of_the_readme_is_tried_or_listed():
    tried, listed = release.split_commands(release.list_commands(README))
    assert [line.split()[1] for line in tried] == ["demo"]
    assert {line.split()[0] for line in listed} >= {"pip", "make", "spoofgym"}
    assert {"make bench", "make test", "pip install ."} < {*listed}
    assert "class AverageRate(Detector)" in release.find_detector(README)


def test_what_is_left_to_do_by_hand_depends_on_what_has_been_done():
    project = tomllib.loads((release.ROOT / "pyproject.toml").read_text())["project"]
    filled = {"urls": {"Homepage": "https://spoofgym.org"}}
    placeholders, *rest = release.list_left_over(project, "## 1.0.0\n", "1.0.0")
    assert release.PLACEHOLDER in placeholders
    assert rest == [*release.list_left_over(filled, "## 1.0.0\n", "1.0.0")]
    assert any("v1.0.0" in line for line in rest)
    assert len([*release.list_left_over(filled, "## Unreleased", "1.0.0")]) == len(rest) + 1
