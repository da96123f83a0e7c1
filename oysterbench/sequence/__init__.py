"""Sequence files: their topics, writing and reading."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from oysterbench.core.errors import NoTruthError
from oysterbench.core.measurements import Image, ImuMeasurement
from oysterbench.sequence.types import CameraCalibration, ImuCalibration, Sequence

__all__ = [
    "CameraCalibration",
    "Image",
    "ImuCalibration",
    "ImuMeasurement",
    "Sequence",
    "describe",
    "open_sequence",
    "sequences_in",
]


def open_sequence(path: str | os.PathLike[str]) -> Sequence:
    """Open an oysterbench MCAP file or a folder in EuRoC/ASL layout."""
    if Path(path).is_dir():
        from oysterbench.sequence.euroc import EurocSequence

        return EurocSequence(path)
    from oysterbench.sequence.read import McapSequence

    return McapSequence(path)


def sequences_in(path: str | os.PathLike[str]) -> list[Path]:
    """Sequence files and folders in EuRoC layout in a folder; the path itself where it is a sequence, or has none."""
    place = Path(path)
    if (place / "mav0").is_dir():
        return [place]
    folders = [mav0.parent for mav0 in place.glob("[!.]*/mav0") if mav0.is_dir()]
    return sorted([*place.glob("*.mcap"), *folders]) or [place]


def describe(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Content of a sequence as JSON values: names, duration, path length, cameras, topics with counts and rates."""
    sequence = open_sequence(path)
    cameras = {
        name: {"width": camera.width, "height": camera.height, "rate_hz": camera.rate_hz}
        for name, camera in sequence.cameras.items()
    }
    try:
        truth = sequence.truth()
    except NoTruthError:
        truth = None
    rates = {topic: None if rate is None else round(rate, 1) for topic, rate in sequence.rates().items()}
    return {
        "sequence": sequence.name,
        "duration_s": round(sequence.duration_s, 9),
        "path_length_m": None if truth is None else truth.path_length,
        "metadata": dict(sequence.metadata),
        "cameras": cameras,
        "topics": [
            {"topic": topic, "type": kind, "messages": n, "rate_hz": rates[topic]}
            for topic, kind, n in sequence.contents()
        ],
    }
