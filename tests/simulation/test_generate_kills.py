"""A render that is killed at random moments, again and again."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

KILLS = 50

RENDER = """
import sys
from pathlib import Path
from oysterbench.simulation.generate import generate_split
from oysterbench.recipe import parse_split
split = parse_split(Path(sys.argv[1]).read_text(), "tiny.toml", rig_source=Path(sys.argv[2]).read_text())
if __name__ == "__main__":
    print(flush=True)  # what follows is the render, not the start of Python
    generate_split(split, Path(sys.argv[3]), workers=int(sys.argv[4]))
"""


@pytest.mark.slow
def test_fifty_kills_at_random_moments_end_in_the_same_bytes(tiny_file, tmp_path):
    """No kill costs a finished frame; each render goes on where the last was killed, and the end is right."""
    script, recipe, rig = (tmp_path / name for name in ("render.py", "tiny.toml", "rig.toml"))
    script.write_text(RENDER)
    recipe.write_text(TINY_SPLIT)
    rig.write_text(TINY_RIG)
    wanted = hashlib.sha256(tiny_file.read_bytes()).hexdigest()
    rng = np.random.default_rng(20261120)
    kills, renders, resumed = 0, 0, 0
    while kills < KILLS:
        renders += 1
        out, before = tmp_path / f"out-{renders}", 0
        finished = out / "tiny-01.mcap"
        while not finished.exists():
            command = [sys.executable, script, recipe, rig, out, str(1 + renders % 2)]
            process = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
            assert process.stdout is not None
            process.stdout.readline()
            try:
                process.wait(timeout=rng.uniform(0.0, 12.0) if kills < KILLS else 600)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                kills += 1
            process.stdout.close()
            there = len(list(out.glob(".parts/*/*.part")))
            assert there >= before or finished.exists(), "what was finished is kept"
            resumed += before > 0
            before = there
        assert hashlib.sha256(finished.read_bytes()).hexdigest() == wanted
    assert resumed > 0
