"""Jobs in processes: a script that starts them needs no guard, as they do not run it again."""

from __future__ import annotations

import os
import subprocess
import sys

from tests.helpers.paths import ROOT

SCRIPT = """
import operator
from oysterbench.simulation.scheduling import run_in_processes

print("the script runs")
print(sorted(run_in_processes(operator.neg, [1, 2, 3], 2, dict)))
import __main__
print(__main__.__file__)
"""


def test_a_script_without_a_guard_is_run_once(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=120, env=environment, check=False
    )
    assert done.stdout.splitlines() == ["the script runs", "[(1, -1), (2, -2), (3, -3)]", str(script)], done.stderr
