"""What commands take is measured by a process of their own."""

import gc

import pytest

from tools.costs import play


def test_a_process_is_measured_and_waited_for_once(tmp_path):
    took, printed = play(["-c", "print(7)"], str(tmp_path))
    gc.collect()  # a process that seems to run on is a ResourceWarning
    assert printed == ["7"]
    assert took.keys() == {"cpu_s", "memory_mb"}
    with pytest.raises(SystemExit, match=r"exit\(3\).* failed"):
        play(["-c", "exit(3)"], str(tmp_path))
