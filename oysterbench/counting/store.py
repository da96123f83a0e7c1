"""The folder of counts: what is finished is kept picture by picture, so that the same command resumes from there.

```
masks/NAME.png        16 bits: numbers of oysters, 0 for none; none where a method gives only boxes
overlays/NAME.jpg     the picture with outlines
videos/NAME.mp4       overlays of the frames of a video
finished/NAME.json    what is counted, and the digest of what it depends on; written last
finished/VIDEO/.frames.json    which frames of a video are looked at, once all have been; .film: what its film is of
```
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.folders import write_picture
from oysterbench.core.files import write_atomically
from oysterbench.counting.copies import SIDE
from oysterbench.counting.measure import OysterRow, PictureCount

UNITS = 256
"""Of a thumbnail as it is kept, in a grey level."""


class _Finished(msgspec.Struct, frozen=True):
    """A picture that is counted. small: its thumbnail, in units of 1/256 grey level, little-endian; none of a frame."""

    key: str
    picture: PictureCount
    oysters: list[OysterRow]
    small: bytes = b""


class _Frames(msgspec.Struct, frozen=True):
    """The frames of a video that are looked at, as index and time in s, and why it may have ended before its time."""

    key: str
    frames: list[tuple[int, float]]
    failure: str = ""


class Store:
    """A folder of counts. again: nothing in it counts as finished."""

    def __init__(self, folder: Path, again: bool = False) -> None:
        self.folder, self.again = folder, again

    @property
    def begun(self) -> bool:
        """Whether a count has kept something in it."""
        return (self.folder / "finished").is_dir()

    def mask(self, name: str) -> Path:
        """Where the numbers of a picture's oysters are."""
        return self.folder / "masks" / f"{name}.png"

    def overlay(self, name: str) -> Path:
        """Where a picture with outlines is."""
        return self.folder / "overlays" / f"{name}.jpg"

    def film(self, video: str) -> Path:
        """Where the overlays of a video are."""
        return self.folder / "videos" / (video if video.lower().endswith(".mp4") else f"{video}.mp4")

    def write(
        self,
        key: str,
        picture: PictureCount,
        oysters: Sequence[OysterRow],
        numbers: NDArray[np.uint16] | None,
        overlay: bytes,
        small: NDArray[np.float32] | None = None,
    ) -> None:
        """Keep a picture, with its thumbnail (`copies`); what says that it is finished comes last."""
        self._record(picture.name).unlink(missing_ok=True)
        if numbers is not None:
            write_picture(self.mask(picture.name), numbers)
        write_atomically(self.overlay(picture.name), overlay)
        kept = b"" if small is None else np.round(UNITS * small).astype("<u2").tobytes()
        content = msgspec.json.encode(_Finished(key, picture, list(oysters), kept))
        write_atomically(self._record(picture.name), content)

    def finished(self, name: str, key: str) -> PictureCount | None:
        """The count of a picture, if it is there with that key, and with its overlay, and its mask, if it has one."""
        held = None if self.again else self._read(name)
        if held is None or held.key != key or not self.overlay(name).is_file():
            return None
        return held.picture if held.picture.cover is None or self.mask(name).is_file() else None

    def small(self, name: str) -> NDArray[np.float32] | None:
        """The thumbnail of a picture that is finished, if it was kept."""
        held = self._read(name)
        if held is None or len(held.small) != 2 * SIDE**2:
            return None
        return np.frombuffer(held.small, "<u2").reshape(SIDE, SIDE).astype(np.float32) / np.float32(UNITS)

    def others(self, names: Collection[str]) -> list[str]:
        """Pictures and frames that are counted in it, and not among these names: of earlier counts."""
        folder = self.folder / "finished"
        found = (path.relative_to(folder).as_posix().removesuffix(".json") for path in sorted(folder.rglob("*.json")))
        return [name for name in found if name not in names and not Path(name).name.startswith(".")]

    def oysters(self, name: str) -> list[OysterRow]:
        """Of a picture that is finished."""
        held = self._read(name)
        return [] if held is None else held.oysters

    def write_frames(self, video: str, key: str, frames: Sequence[tuple[int, float]], failure: str) -> None:
        """Keep which frames of a video are looked at."""
        write_atomically(self._frames(video), msgspec.json.encode(_Frames(key, list(frames), failure)))

    def frames(self, video: str, key: str) -> tuple[list[tuple[int, float]], str] | None:
        """Frames of a video that was read to its end, and why that came early, if it did."""
        if self.again:
            return None
        try:
            held = msgspec.json.decode(self._frames(video).read_bytes(), type=_Frames)
        except (OSError, msgspec.DecodeError):
            return None
        return (held.frames, held.failure) if held.key == key else None

    def film_is_of(self, video: str, key: str) -> bool:
        """Whether the film of a video is there, made of what the key says."""
        held = self._film_key(video)
        return self.film(video).is_file() and held.is_file() and held.read_text(encoding="utf-8") == key

    def write_film_key(self, video: str, key: str) -> None:
        """Keep what a film was made of."""
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
        except (OSError, msgspec.DecodeError):  # not there, or another version's
            return None
