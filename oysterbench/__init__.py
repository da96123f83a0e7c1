"""oysterbench: benchmarks for underwater robots on seeded, re-creatable oyster reefs.

>>> import oysterbench
>>> sequence = oysterbench.open("mini-01.mcap")          # doctest: +SKIP
>>> for image in sequence.images("cam_front"):           # doctest: +SKIP
...     print(image.stamp_ns, image.pixels.shape)
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from oysterbench.core import pictures as _pictures  # noqa: F401  before OpenCV, for which it sets a limit
from oysterbench.version import VERSION as __version__

if TYPE_CHECKING:
    from oysterbench.sequence import Sequence

__all__ = ["__version__", "open"]


def open(path: str | os.PathLike[str]) -> Sequence:
    """Open a sequence: an oysterbench MCAP file or a folder in EuRoC/ASL layout.

    Raises
    ------
    oysterbench.core.errors.SequenceError
        The file is absent, truncated, damaged or not a sequence.
    """
    from oysterbench.sequence import open_sequence  # numpy and OpenCV are loaded only when needed

    return open_sequence(path)
