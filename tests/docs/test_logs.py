"""The programs of other languages on the page of logs write the table that it describes."""

import re
import shutil
import subprocess

import pytest

from spoofgym import InnovationLog

from .pages import text_of

pytest.importorskip("pandas")
PROGRAMS = dict(re.findall(r"```(matlab|cpp)\n(.*?)```", text_of("logs.md"), flags=re.DOTALL))


def check_table(path):
    log = InnovationLog.load(path)
    assert (len(log.time), log.channels) == (800, ("down", "east", "north"))
    assert all(0.9 < each.nis < 1.1 for each in log.check_signals())


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_the_program_in_cpp_writes_a_table(tmp_path):
    (tmp_path / "walk.cpp").write_text(PROGRAMS["cpp"])
    compile_it = ["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "walk.cpp", "-o", "walk"]
    subprocess.run(compile_it, cwd=tmp_path, check=True)
    subprocess.run(["./walk"], cwd=tmp_path, check=True)
    check_table(tmp_path / "walk.csv")


@pytest.mark.skipif(shutil.which("octave") is None, reason="needs Octave")
def test_the_program_in_matlab_writes_a_table(tmp_path):
    (tmp_path / "walk.m").write_text(PROGRAMS["matlab"])
    subprocess.run(["octave", "--quiet", "--no-gui", "walk.m"], cwd=tmp_path, check=True)
    check_table(tmp_path / "walk.csv")


def test_both_programs_write_the_same_lines():
    """What is left of a check where there is no Octave."""
    lines = [re.findall(r'fprintf\(file, ("[^"]*")', code) for code in PROGRAMS.values()]
    assert lines[0] == lines[1]
    assert len(lines[0]) == 3
    assert all(len(code.splitlines()) <= 20 for code in PROGRAMS.values())
