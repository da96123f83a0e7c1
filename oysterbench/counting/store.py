"""Folder of counts: finished work is stored image by image, so that the same command resumes from there.

```
masks/NAME.png        16 bits: numbers of oysters that count, 0 for none; no file if a method gives only boxes
overlays/NAME.jpg     the image with outlines
videos/NAME.mp4       overlays of the frames of a video
finished/NAME.json    the count, and the digest of what it depends on; written last
finished/VIDEO/.frames.json    which frames of a video are used, once all have been read; .film: key of its film
```
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.folders import write_picture
from oysterbench.core.atomic import write_atomically
from oysterbench.counting.copies import SIDE
from oysterbench.counting.measure import OysterRow, PictureCount

UNITS = 256
"""Units of a stored thumbnail per grey level."""


class _Finished(msgspec.Struct, frozen=True):
    """Record of a counted image. small: thumbnail in units of 1/256 grey level, little-endian; empty for a frame."""

    key: str
    picture: PictureCount
    oysters: list[OysterRow]
    small: bytes = b""


class _Frames(msgspec.Struct, frozen=True):
    """Record of the frames of a video that are used, as index and time in s, and why it ended early, if it did."""

    key: str
    frames: list[tuple[int, float]]
    failure: str = ""


class Store:
    """A folder of counts."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def begun(self) -> bool:
        """Whether a count has stored anything in it."""
        return (self.folder / "finished").is_dir()

    def start_over(self, pictures: Iterable[str], videos: Iterable[str]) -> None:
        """Take nothing of these names as finished: their records are emptied, so that if the count is interrupted, no
        record of an earlier one is taken for one of it."""
        records = [self._record(name) for name in pictures]
        for video in videos:
            records += sorted((self.folder / "finished" / video).glob("*.json"))
        for record in records:
            if record.is_file():
                record.write_bytes(b"")

    def mask(self, name: str) -> Path:
        """Path of the numbers of an image's oysters that count."""
        return self.folder / "masks" / f"{name}.png"

    def overlay(self, name: str) -> Path:
        """Path of the overlay of an image."""
        return self.folder / "overlays" / f"{name}.jpg"

    def film(self, video: str) -> Path:
        """Path of the film of a video's overlays; no two videos share one."""
        *inner, last = Path(video).suffixes or [""]
        own = last.lower() == ".mp4" and not inner  # dive.avi.mp4 is the film of dive.avi
        return self.folder / "videos" / (video if own else f"{video}.mp4")

    def write(
        self,
        key: str,
        picture: PictureCount,
        oysters: Sequence[OysterRow],
        numbers: NDArray[np.uint16] | None,
        overlay: bytes,
        small: NDArray[np.float32] | None = None,
    ) -> None:
        """Store a counted image, with its thumbnail (`copies`); the record that marks it as finished comes last."""
        self._record(picture.name).unlink(missing_ok=True)
        if numbers is not None:
            write_picture(self.mask(picture.name), numbers)
        write_atomically(self.overlay(picture.name), overlay)
        kept = b"" if small is None else np.round(UNITS * small).astype("<u2").tobytes()
        content = msgspec.json.encode(_Finished(key, picture, list(oysters), kept))
        write_atomically(self._record(picture.name), content)

    def finished(self, name: str, key: str) -> PictureCount | None:
        """Count of an image, if it is stored with that key, its overlay, and its mask, if it has one; else None."""
        held = self._read(name)
        if held is None or held.key != key or not self.overlay(name).is_file():
            return None
        return held.picture if held.picture.cover is None or self.mask(name).is_file() else None

    def small(self, name: str) -> NDArray[np.float32] | None:
        """Thumbnail of a finished image, if it was stored."""
        held = self._read(name)
        if held is None or len(held.small) != 2 * SIDE**2:
            return None
        return np.frombuffer(held.small, "<u2").reshape(SIDE, SIDE).astype(np.float32) / np.float32(UNITS)

    def others(self, names: Collection[str]) -> list[str]:
        """Names of images and frames counted in it that are not among `names`: those of earlier counts."""
        folder = self.folder / "finished"
        found = (path.relative_to(folder).as_posix().removesuffix(".json") for path in sorted(folder.rglob("*.json")))
        return [name for name in found if name not in names and not Path(name).name.startswith(".")]

    def oysters(self, name: str) -> list[OysterRow]:
        """Oysters of a finished image; empty if there is none."""
        held = self._read(name)
        return [] if held is None else held.oysters

    def write_frames(self, video: str, key: str, frames: Sequence[tuple[int, float]], failure: str) -> None:
        """Store which frames of a video are used."""
        write_atomically(self._frames(video), msgspec.json.encode(_Frames(key, list(frames), failure)))

    def frames(self, video: str, key: str) -> tuple[list[tuple[int, float]], str] | None:
        """Frames of a video that has been read, and why it ended early, if it did; None if there is no such record."""
        try:
            held = msgspec.json.decode(self._frames(video).read_bytes(), type=_Frames)
        except (OSError, msgspec.DecodeError):
            return None
        return (held.frames, held.failure) if held.key == key else None

    def film_is_of(self, video: str, key: str) -> bool:
        """Whether the film of a video exists, and was made from what the key stands for."""
        held = self._film_key(video)
        return self.film(video).is_file() and held.is_file() and held.read_text(encoding="utf-8") == key

    def write_film_key(self, video: str, key: str) -> None:
        """Store the key of what a film was made from."""
        write_atomically(self._film_key(video), key.encode())

    def _record(self, name: str) -> Path:
        return self.folder / "finished" / f"{name}.json"

    def _frames(self, video: str) -> Path:
        return self.folder / "finished" / video / ".frames.json"

    def _film_key(self, video: str) -> Path:
        return self.folder / "finished" / video / ".film"

    def _read(self, name: str) -> _Finished | None:
        try:
            return msgspec.json.decode(self._record(name).read_bytes(), type=_Finished)
        except (OSError, msgspec.DecodeError):  # missing, or from another version
            return None
