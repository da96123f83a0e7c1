"""Memory of large arrays is handed back to the system, or kept for the next ones."""

from __future__ import annotations

import ctypes
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="malloc is not that of glibc")

SCRIPT = """
import sys
from pathlib import Path
from oysterbench_baselines.common.memory import hand_back, keep_freed

def held_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

if sys.argv[1] == "kept":
    keep_freed()
before = held_mb()
large = bytearray(b"x") * 100_000_000
del large
print(held_mb() - before)
hand_back()
print(held_mb() - before)
"""


@pytest.mark.parametrize(("how", "held"), [("kept", 100), ("not kept", 0)])
def test_what_is_freed_is_held_until_it_is_handed_back(how, held):
    run = subprocess.run([sys.executable, "-c", SCRIPT, how], capture_output=True, text=True, check=True)
    freed, handed_back = map(float, run.stdout.split())
    assert freed == pytest.approx(held, abs=10)
    assert handed_back == pytest.approx(0, abs=10)
