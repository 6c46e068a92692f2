"""A release tries what the README names, and does not keep silent on the rest."""

import json
import tomllib

import pytest
from packaging.requirements import Requirement

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


def release_with(versions, monkeypatch, folder):
    """A release whose programs do nothing, but that a bill of materials names these versions."""

    def run(program, *words, **_):
        if program.name == "cyclonedx-py":
            named = [{"name": name, "version": version} for name, version in versions.items()]
            bom = words[words.index("-o") + 1]
            bom.write_text(json.dumps({"components": named, "root": words[-1].name}))
            assert 'version = "1.0.0"' in words[words.index("--pyproject") + 1].read_text()

    monkeypatch.setattr(release, "DIST", folder)
    monkeypatch.setattr(release, "run", run)
    monkeypatch.setattr(release.venv, "create", lambda at, **_: (at / "bin").mkdir(parents=True))
    for name in ("spoofgym-1.0.0-py3-none-any.whl", "spoofgym-1.0.0.tar.gz"):
        (folder / name).touch()
    monkeypatch.setattr(release, "build", lambda _: sorted(folder.glob("spoofgym-*")))
    release.main()


def test_a_bill_of_materials_stands_beside_both_distributions(monkeypatch, tmp_path, capsys):
    pins = [Requirement(line) for line in release.PINS.read_text().splitlines() if line[0] != "#"]
    versions = {pin.name: next(iter(pin.specifier)).version for pin in pins}
    assert {"numpy", "numba", "gymnasium", "cyclonedx-bom"} < {*versions}
    release_with(versions, monkeypatch, tmp_path)
    assert "spoofgym-1.0.0.cdx.json  sha256" in capsys.readouterr().out
    assert json.loads((tmp_path / "spoofgym-1.0.0.cdx.json").read_text())["root"] == "python"


@pytest.mark.parametrize("version", ["1.0", None])
def test_no_release_whose_bill_of_materials_names_what_is_not_pinned(
    version, monkeypatch, tmp_path
):
    with pytest.raises(SystemExit, match=r"does not pin Jinja2==(1\.0|None)$"):
        release_with({"Jinja2": version}, monkeypatch, tmp_path)
