"""Files are whole or absent."""

import subprocess
import sys

import pytest

from spoofgym.core.files import remove_stale_parts, whole_file, write_file


def test_a_file_is_written_with_its_folder_and_is_whole_or_absent(tmp_path, monkeypatch):
    path = tmp_path / "new" / "file.bin"
    for content in (b"first", b"", b"last \x00 one"):
        write_file(path, content)
        assert (path.read_bytes(), list(path.parent.iterdir())) == (content, [path])
    with whole_file(path) as mine:  # two writers do not meet
        mine.write_bytes(b"mine")
        write_file(path, b"yours")
        assert mine.read_bytes() == b"mine"
    assert path.read_bytes() == b"mine"

    def dies(_):
        raise KeyboardInterrupt

    monkeypatch.setattr("os.fsync", dies)
    with pytest.raises(KeyboardInterrupt):
        write_file(path, b"new")
    assert (path.read_bytes(), list(path.parent.iterdir())) == (b"mine", [path])


@pytest.mark.parametrize("links", [True, False])
def test_an_exclusive_file_replaces_none(tmp_path, monkeypatch, links):
    def refused(*_):
        raise PermissionError

    if not links:
        monkeypatch.setattr("os.link", refused)
    path = tmp_path / "file.bin"
    write_file(path, b"first", exclusive=True)
    with pytest.raises(FileExistsError):
        write_file(path, b"second", exclusive=True)
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"first", [path])


def test_only_parts_of_dead_processes_are_removed(tmp_path):
    code = (
        "import os, sys\nfrom pathlib import Path\nfrom spoofgym.core.files import whole_file\n"
        "with whole_file(Path(sys.argv[1])) as part:\n"
        "    part.write_bytes(b'half')\n    os._exit(0)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "file.bin")], check=True)
    (stale,) = tmp_path.iterdir()
    assert stale.name.endswith(".part")
    other = tmp_path / "thesis.part"
    other.write_bytes(b"years of work")
    elsewhere = stale.with_name("spoofgym-0badcafe-" + stale.name.split("-", 2)[2])
    elsewhere.write_bytes(b"half")
    with whole_file(tmp_path / "file.bin") as living:
        living.write_bytes(b"half")
        remove_stale_parts(tmp_path)
        assert {*tmp_path.iterdir()} == {other, elsewhere, living}
