"""Compiles the renderer's kernels once: `python -m tests.helpers.compile_kernels`.

Otherwise each process of the first tests, of which several run side by side, compiles them for itself.
"""

from __future__ import annotations

import warp

from oysterbench.render.target import start_warp
from oysterbench.sensors.video import motion, planes, prediction
from oysterbench.simulation import sensor_simulation

KERNELS = (sensor_simulation, motion, planes, prediction)
"""Whose imports bring all of them."""

if __name__ == "__main__":
    start_warp()
    warp.force_load("cpu")
