"""Start-up of Warp, and compiler options of its kernels for the same arithmetic on every processor."""

from __future__ import annotations

import os
import platform
import sys
from typing import Any

import warp as wp

COMPILER_FLAGS = "-mllvm=-inline-threshold=100000 -mllvm=-inline-cold-callsite-threshold=100000"
if platform.machine() in ("x86_64", "AMD64"):
    # One target for all: native instructions are no faster here, and hosts can share a kernel cache.
    COMPILER_FLAGS += " -target-cpu x86-64-v2"

# No fused or reordered arithmetic, so that every processor produces the same bytes.
KERNEL_OPTIONS: dict[str, Any] = {
    "cpu_compiler_flags": COMPILER_FLAGS,
    "fuse_fp": False,
    "fast_math": False,
    "enable_backward": False,
}
"""Options of every module with kernels."""


def start_warp() -> None:
    """Start Warp without its greeting, and without its native warning if there is no CUDA driver."""
    wp.config.log_level = wp.LOG_ERROR
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
