"""The sequence file itself (ROS 2, MCAP), whole or without the ground truth, as for a hidden split."""

from __future__ import annotations

import shutil
from pathlib import Path

from oysterbench.core.errors import SequenceError
from oysterbench.sequence.cut import cut_public
from oysterbench.sequence.export.steps import Steps
from oysterbench.sequence.types import Sequence


def write(sequence: Sequence, folder: Path, truth: bool, steps: Steps) -> list[str]:
    """Write NAME.mcap."""
    source = getattr(sequence, "path", None)
    if source is None or not Path(source).is_file():
        raise SequenceError(f"{sequence.name}: the format mcap needs a sequence file, and this is not one")
    out = folder / f"{sequence.name}.mcap"
    if truth:
        steps.need(Path(source).stat().st_size)
        shutil.copyfile(source, out)
        return []
    with open(out, "wb") as file:
        cut_public(Path(source), file)
    return ["topics and attachments of the truth, the recipe and digests were left out"]
