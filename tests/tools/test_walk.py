"""Which files count as a part of a command's walk."""

import threading

import pytest
import typer

from spoofgym.core.settings import compute_digest, describe
from spoofgym.policies.zoo import list_shipped, load_card
from tools import walk


def test_functions_that_run_count_once_in_order_and_in_threads():
    def work():
        compute_digest(describe({"a": 1.0}))
        thread = threading.Thread(target=list_shipped)
        thread.start()
        thread.join()
        describe(1.0)

    with walk.called_files() as found:
        work()
    assert list(found) == ["core/settings.py", "policies/zoo/__init__.py"]
    load_card(list_shipped()[0])  # no longer counted
    assert len(found) == 2
    expected = {"policies": ["policies/zoo/__init__.py"], "bench": []}
    assert walk.walk(list_shipped, ["policies", "bench"]) == expected
    with pytest.raises(typer.BadParameter, match="either a command"):
        walk.main([], "")
