"""The sequence file: topics, writing, reading."""

from __future__ import annotations

import os
from pathlib import Path

from oysterbench.sequence.types import (
    CameraCalibration,
    Image,
    ImuCalibration,
    ImuSample,
    Sequence,
)

__all__ = ["CameraCalibration", "Image", "ImuCalibration", "ImuSample", "Sequence", "open_sequence"]


def open_sequence(path: str | os.PathLike[str]) -> Sequence:
    """Open an oysterbench MCAP file or a folder in EuRoC/ASL layout."""
    if Path(path).is_dir():
        from oysterbench.sequence.euroc import EurocSequence

        return EurocSequence(path)
    from oysterbench.sequence.read import McapSequence

    return McapSequence(path)
