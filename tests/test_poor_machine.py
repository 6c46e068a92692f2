"""A poor machine: 60 columns, no colour, no home, no display, no network, little patience."""

import fcntl
import functools
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path

import numba
import pytest

ROOT = Path(__file__).resolve().parents[1]
COLUMNS = 60
COLOUR = re.compile(r"\x1b\[[0-9;]*[34]\d[;m]")
NO_NETWORK = """
import socket

def refuse(*_, **__):
    raise OSError("this test has no network")

socket.socket.connect = socket.create_connection = socket.getaddrinfo = refuse
"""
compiles = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")


def poor(folder, **more):
    """Environment with nothing but paths, in which Python can't reach the network."""
    (folder / "sitecustomize.py").write_text(NO_NETWORK)
    paths = {"PATH": os.environ["PATH"], "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}
    return {**paths, "TERM": "xterm-256color", **more}


def on_terminal(words, variables, folder, until=None):
    """Exit code, and what a command writes to a narrow terminal; interrupted after some word."""
    main, other = pty.openpty()
    fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", 24, COLUMNS, 0, 0))
    command = [sys.executable, "-m", "spoofgym", *words]
    ends = {"stdin": subprocess.DEVNULL, "stdout": other, "stderr": other}
    # which what starts the tests may ignore, as a shell does in the background
    heed = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    process = subprocess.Popen(command, env=variables, cwd=folder, preexec_fn=heed, **ends)
    os.close(other)
    text, began = "", time.monotonic()
    while time.monotonic() - began < 600.0:
        if not select.select([main], [], [], 1.0)[0]:
            continue
        try:
            text += os.read(main, 65536).decode(errors="replace")
        except OSError:  # its end, on Linux
            break
        if until is not None and until in text:
            process.send_signal(signal.SIGINT)
            until = None
    os.close(main)
    return process.wait(timeout=60.0), text


def test_tables_fit_a_narrow_terminal_without_colour(tmp_path):
    code, text = on_terminal(["list", "detectors"], poor(tmp_path, NO_COLOR="1"), tmp_path)
    lines = re.sub(r"\r|\x1b\[[0-9;]*m", "", text).splitlines()  # bold heads are no letters
    assert code == 0, text
    assert len(lines) > 40
    assert max(map(len, lines)) <= COLUMNS
    assert not COLOUR.search(text)


@compiles
@pytest.mark.nightly
def test_a_first_run_that_is_interrupted_while_it_compiles_goes_on(tmp_path):
    variables = poor(tmp_path, NO_COLOR="1", SPOOFGYM_CACHE_DIR=str(tmp_path / "cache"))
    code, text = on_terminal(["demo"], variables, tmp_path, until="compiling")
    assert code == 130, text
    assert "Traceback" not in text
    assert text.count("spoofgym: interrupted") == 1
    assert not (tmp_path / "demo.png").exists()
    code, text = on_terminal(["demo"], variables, tmp_path)
    assert code == 0, text
    assert not COLOUR.search(text)
    assert "Next: spoofgym audit ewma --budget quick" in text
    assert (tmp_path / "demo.png").stat().st_size > 20_000


@compiles
@pytest.mark.nightly
def test_a_demo_needs_neither_home_nor_display_nor_network(tmp_path):
    command = [sys.executable, "-m", "spoofgym", "demo"]
    # not even root can make that home; what is compiled goes to the temporary folder then
    variables = poor(tmp_path, HOME="/proc/none", TMPDIR=str(tmp_path))
    done = subprocess.run(command, env=variables, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "ewma raises no alarm" in done.stdout
    assert done.stderr.count("Warning") == 1, done.stderr
    assert "cache" in done.stderr
    assert (tmp_path / "demo.png").is_file()
