"""The device that renders: the CPU, or a CUDA GPU."""

from __future__ import annotations

import warp as wp

from oysterbench.core.errors import OysterbenchError
from oysterbench.render.target import start_warp


def check_device(name: str) -> None:
    """Raise OysterbenchError unless Warp can compute on the named device of this machine: `cpu`, `cuda` or `cuda:N`."""
    if name == "cpu":
        return
    start_warp()
    known = [device.alias for device in wp.get_devices()]
    if name in known or (name == "cuda" and wp.is_cuda_available()):
        return
    raise OysterbenchError(
        f"--device {name}: there is no such device here; expected one of {', '.join(known)}. CUDA needs an NVIDIA GPU "
        "and its driver; without --device, the CPU renders"
    )
