"""Memory that is no longer needed: handed back to the system, or kept for what comes next."""

from __future__ import annotations

import ctypes
import gc


def hand_back() -> None:
    """Free what nothing refers to any more, pages of the allocator included (glibc keeps them otherwise)."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


MOST_FREE, LARGEST_KEPT = -1, -3
"""Parameters of glibc's mallopt: M_TRIM_THRESHOLD, M_MMAP_THRESHOLD (malloc.h)."""


def keep_freed() -> None:
    """Keep the memory of large arrays that are freed for those that come next (glibc; elsewhere nothing is changed).
    Otherwise the system clears new pages for each of them, which takes a tenth of a network's time."""
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        set_option(LARGEST_KEPT, 1 << 30)
        set_option(MOST_FREE, (1 << 31) - 1)
