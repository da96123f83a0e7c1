"""Memory that is no longer needed, handed back to the system."""

from __future__ import annotations

import ctypes
import gc


def hand_back() -> None:
    """Free what nothing refers to any more, pages of the allocator included (glibc keeps them otherwise)."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
