"""The page on threats names them all, and its code runs."""

import re
import sys
import types
from pathlib import Path

import pytest

from spoofgym.attacks import THREATS

# as users have it
pytestmark = pytest.mark.usefixtures("default_rate")

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "threats.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
SHORT = {"warmup_s": 10.0, "live_s": 5.0, "attack_s": 10.0, "time_to_alert_s": 1.0}


@pytest.fixture(scope="module")
def code():
    module = types.ModuleType("threats_page")
    sys.modules["threats_page"] = module
    for block in BLOCKS:
        exec(compile(block, "docs/threats.md", "exec"), module.__dict__)
    yield module
    del sys.modules["threats_page"]


@pytest.mark.parametrize("name", THREATS)
def test_every_threat_has_its_two_rows_and_plays(code, name):
    assert len(re.findall(rf"^\| `{name}` \|", PAGE, flags=re.M)) == 2
    alarmed, east, undetected = code.play(name, runs=2, timeline=SHORT)
    assert 0.0 <= alarmed <= 1.0
    assert undetected >= east - 1e-9 or alarmed > 0.0


def test_links_lead_somewhere():
    index = (ROOT / "docs" / "README.md").read_text()
    assert "(threats.md)" in index
