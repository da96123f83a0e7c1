"""The tracks: each an object that says how its methods are run, and how their predictions are scored and shown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module

from oysterbench.tracks.track import Evaluation, Option, Request, Track

NAMES = ("slam", "segmentation", "detection", "density", "steering")


class TrackRegistry(Mapping[str, Track]):
    """Name -> track; the module of a track is imported on first access."""

    def __getitem__(self, name: str) -> Track:
        if name not in NAMES:
            raise KeyError(name)
        found = import_module(f"{__name__}.{name}").TRACK
        assert isinstance(found, Track)
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(NAMES)

    def __len__(self) -> int:
        return len(NAMES)


TRACKS: Mapping[str, Track] = TrackRegistry()

__all__ = ["NAMES", "TRACKS", "Evaluation", "Option", "Request", "Track"]
