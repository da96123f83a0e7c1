"""oysterbench: benchmarks for underwater robots on seeded, reproducible oyster reefs.

Data come by name, rendered or downloaded on first use:

>>> import oysterbench
>>> split = oysterbench.split("slam-mini")
>>> split.names
('mini-01',)
>>> with oysterbench.open("mini-01.mcap") as sequence:
...     image = next(sequence.images("cam_left"))
>>> image.pixels.shape
(48, 64, 3)

Poses, or files of them, are scored in one call, and each metric is also a function of its own:

>>> oysterbench.score("mini-01.mcap", sequence.truth()).metrics["coverage"]
1.0
>>> oysterbench.metrics.iou([[1, 1, 0]], [[1, 0, 0]])
0.5

`oysterbench.torch` has data sets for training, which need PyTorch: pip install 'oysterbench[learn]'.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

from oysterbench.core import pictures as _pictures  # noqa: F401  before OpenCV, for which it sets a limit
from oysterbench.version import VERSION as __version__

if TYPE_CHECKING:
    from oysterbench import metrics, torch
    from oysterbench.annotations import open_labelled as labelled
    from oysterbench.core.errors import OysterbenchError
    from oysterbench.core.trajectory import Trajectory, read_trajectory
    from oysterbench.evaluate.slam import SlamResult, SlamSettings
    from oysterbench.notebook.doctor import doctor
    from oysterbench.notebook.mapping import oyster_map
    from oysterbench.notebook.score import score
    from oysterbench.notebook.split import Split, split, splits
    from oysterbench.sequence import Sequence

__all__ = [
    "OysterbenchError",
    "Sequence",
    "SlamResult",
    "SlamSettings",
    "Split",
    "Trajectory",
    "__version__",
    "doctor",
    "labelled",
    "metrics",
    "open",
    "oyster_map",
    "read_trajectory",
    "score",
    "split",
    "splits",
    "torch",
]

_HOMES = {
    "OysterbenchError": "oysterbench.core.errors",
    "Sequence": "oysterbench.sequence",
    "SlamResult": "oysterbench.evaluate.slam",
    "SlamSettings": "oysterbench.evaluate.slam",
    "Split": "oysterbench.notebook.split",
    "Trajectory": "oysterbench.core.trajectory",
    "doctor": "oysterbench.notebook.doctor",
    "labelled": "oysterbench.annotations:open_labelled",
    "metrics": "",
    "oyster_map": "oysterbench.notebook.mapping",
    "read_trajectory": "oysterbench.core.trajectory",
    "score": "oysterbench.notebook.score",
    "split": "oysterbench.notebook.split",
    "splits": "oysterbench.notebook.split",
    "torch": "",
}
"""Public name -> module that has it, imported when the name is first used; empty for modules themselves."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'oysterbench' has no attribute {name!r}; it has {', '.join(sorted(__all__))}")
    home, _, own = _HOMES[name].partition(":")
    found = (
        getattr(importlib.import_module(home), own or name) if home else importlib.import_module(f".{name}", __name__)
    )
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def open(path: str | os.PathLike[str]) -> Sequence:
    """Open a sequence: an oysterbench MCAP file or a folder in EuRoC/ASL layout.

    Parameters
    ----------
    path : str or path
        Path of the file or folder.

    Returns
    -------
    Sequence
        Its iterators read the file when they are used, and it may be used in a `with` statement.

    Raises
    ------
    oysterbench.core.errors.SequenceError
        The file is absent, truncated, damaged or not a sequence.

    Examples
    --------
    >>> import oysterbench
    >>> with oysterbench.open("mini-01.mcap") as sequence:
    ...     first = next(sequence.images("cam_left"))
    >>> first.stamp_ns
    1767225600000000000
    """
    from oysterbench.sequence import open_sequence  # numpy and OpenCV are loaded only when needed

    return open_sequence(path)
