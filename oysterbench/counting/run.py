"""Counting the oysters in images and videos with a method, each image once."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError, MethodError, OysterbenchError, SequenceError
from oysterbench.core.text import in_one_line
from oysterbench.counting.copies import Copies, thumbnail
from oysterbench.counting.film import film_rate, write_film
from oysterbench.counting.identity import key_of
from oysterbench.counting.least import Least
from oysterbench.counting.measure import PictureCount, measure, without
from oysterbench.counting.overlay import jpeg, overlay
from oysterbench.counting.oysters import TooManyError, oysters_of
from oysterbench.counting.reading import Sampling, Video, VideoFrame, decode
from oysterbench.counting.scale import QuadratScale, Scale
from oysterbench.counting.sources import Source
from oysterbench.counting.store import Store
from oysterbench.methods.code import file_digest
from oysterbench.methods.images import DetectionMethod, Picture, SegmentationMethod
from oysterbench.methods.interfaces import Stopwatch
from oysterbench.methods.interfaces.images import Prediction, predictions

Pixels = NDArray[np.uint8]

ScaleOf = Callable[[Source, str], Scale | None]
"""Function of a source and the name of its image or frame that returns its scale, None if no scale is used. Raises
LabelError if there should be one and is none."""

FAILURES = 3
"""Number of consecutive failures of a method after which it is not tried on further images."""


@dataclass(frozen=True)
class Settings:
    """Settings of a count. threshold: minimum score of an oyster; sampling: of videos; scale: of each image; least:
    minimum size of an oyster."""

    threshold: float = 0.5
    sampling: Sampling = field(default_factory=Sampling)
    scale: ScaleOf = lambda source, name: None
    least: Least = field(default_factory=Least)


@dataclass
class Counted:
    """Result of a count. pictures: in the order of their names; made: how many of them were counted in this run;
    failures: reasons by name of an image or video; films: paths by name of a video; cpu_s: of the method, in this run;
    copies: names of files, each with that of the earlier one of which it is a copy (`copies`)."""

    pictures: list[PictureCount] = field(default_factory=list)
    made: int = 0
    failures: dict[str, str] = field(default_factory=dict)
    films: dict[str, Path] = field(default_factory=dict)
    cpu_s: float = 0.0
    copies: list[tuple[str, str]] = field(default_factory=list)


@dataclass(frozen=True)
class _Work:
    """An image to be counted. place: index of its source; small: its thumbnail, None for a frame."""

    place: int
    name: str
    key: str
    pixels: Pixels
    scale: Scale | None
    index: int | None = None
    time_s: float | None = None
    small: NDArray[np.float32] | None = None


class Counting:
    """One run over sources. identity: of the method (`identity.method_identity`); progress: is called with the number
    of images done and their total."""

    def __init__(
        self,
        sources: Sequence[Source],
        method: SegmentationMethod | DetectionMethod,
        identity: Mapping[str, Any],
        store: Store,
        settings: Settings,
        progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> None:
        self.sources, self.method, self.identity = sources, method, identity
        self.store, self.settings, self.progress = store, settings, progress
        self.result = Counted()
        self._copies = Copies()
        self._found: dict[str, tuple[int, PictureCount]] = {}
        self._made: set[str] = set()
        self._expected = {source.name: 1 for source in sources}

    def run(self) -> Counted:
        """Count the images that are not finished yet.

        Images that cannot be read, or on which the method fails, are listed in `failures`, and the rest continues.
        Raises MethodError if the method cannot be run, or its output violates the interface.
        """
        works, watch = self._works(), Stopwatch()
        first = next(works, None)  # if nothing is left to do, nothing that the method needs is loaded
        works = works if first is None else itertools.chain([first], works)
        in_row = 0
        while first is not None:
            waiting: dict[str, _Work] = {}
            before = len(self._made)
            error = self._answers(works, waiting, watch)
            if error is None:
                break
            in_row = 1 if len(self._made) > before else in_row + 1
            if not waiting or in_row >= FAILURES:
                where = next(iter(waiting), "its first image")
                raise MethodError(f"method {self.method.name!r} failed on {where}: {error}")
            self.result.failures.update(dict.fromkeys(waiting, f"the method failed on it: {error}"))
            self._tell()
        self.result.made, self.result.cpu_s, self.result.copies = len(self._made), watch.cpu_s, self._copies.found
        in_order = sorted(self._found.values(), key=lambda found: (found[0], found[1].index or 0))
        self.result.pictures = [picture for _, picture in in_order]
        self._films()
        return self.result

    def _answers(self, works: Iterator[_Work], waiting: dict[str, _Work], watch: Stopwatch) -> str | None:
        """Process the method's predictions until all are done (None), or it raises an exception, which is returned."""

        def given() -> Iterator[Picture]:
            for work in works:
                waiting[work.name] = work
                yield Picture(work.name, work.pixels)

        answers = predictions(self.method, given(), "these images", 0, watch)
        while True:
            try:
                answer = next(answers, None)
            except OysterbenchError:
                raise
            except Exception as error:
                return f"{type(error).__name__}: {in_one_line(error)}"
            if answer is None:
                left = next(iter(waiting.values()), None) or next(works, None)
                if left is not None:
                    raise MethodError(f"method {self.method.name!r} ended without a result for {left.name}")
                return None
            self._finish(waiting.pop(answer.name), answer)

    def _finish(self, work: _Work, answer: Prediction) -> None:
        height, width = work.pixels.shape[:2]
        try:
            found = oysters_of(answer, self.method.name, (height, width), self.settings.threshold)
        except TooManyError as error:
            self._fail(work.name, str(error))
            return
        file = str(self.sources[work.place].path)
        picture, rows = measure(found, work.name, file, (height, width), work.scale, self.settings.least)
        picture = replace(picture, index=work.index, time_s=work.time_s)
        region = work.scale.region((height, width)) if isinstance(work.scale, QuadratScale) else None
        drawn = overlay(work.pixels, found.numbers, rows, picture, region)
        left_out = [row.number for row in rows if not row.counted]
        numbers = None if found.numbers is None else without(found.numbers, left_out)
        self.store.write(work.key, picture, rows, numbers, jpeg(drawn), work.small)
        self._made.add(work.name)
        self._keep(work.place, picture)

    def _works(self) -> Iterator[_Work]:
        """Yield the images to be counted, read one by one; those already finished are added to the result."""
        for place, source in enumerate(self.sources):
            try:
                yield from self._frames(place, source) if source.video else self._picture(place, source)
            except (LabelError, SequenceError) as error:
                self._fail(source.name, str(error))
            except OSError as error:
                self._fail(source.name, f"{source.path}: cannot be read: {error.strerror or error}")
            except Exception as error:  # decoders each raise their own for untrusted bytes
                self._fail(source.name, f"{source.path}: cannot be read: {type(error).__name__}: {in_one_line(error)}")

    def _picture(self, place: int, source: Source) -> Iterator[_Work]:
        data = source.path.read_bytes()
        digest = hashlib.sha256(data).hexdigest()
        again = self._copies.bytes_of(source.name, digest)
        key, scale = self._key(source, source.name, digest)
        done = self.store.finished(source.name, key)
        if done is not None:
            small = self.store.small(source.name)
            if small is not None and not again:
                self._copies.picture(source.name, source.path, (done.height, done.width), small)
            self._keep(place, done)
            return
        pixels = decode(data, str(source.path))
        small = thumbnail(pixels)
        if not again:
            self._copies.picture(source.name, source.path, pixels.shape[:2], small)
        yield replace(self._work(place, source.name, key, pixels, scale), small=small)

    def _frames(self, place: int, source: Source) -> Iterator[_Work]:
        sampling, digest = self.settings.sampling, file_digest(source.path)
        self._copies.bytes_of(source.name, digest)
        whole = key_of({"video": digest, "every": sampling.every, "per_second": sampling.per_second})
        known = self.store.frames(source.name, whole)
        if known is not None and self._all_kept(place, source, digest, *known):
            return
        video = Video(source.path)
        self._expected[source.name] = video.estimate(sampling)
        taken: list[tuple[int, float]] = []
        why = ""
        try:
            for frame in video.frames(sampling, lambda index: self._done(source, digest, index) is not None):
                taken.append((frame.index, frame.time_s))
                yield from self._frame(place, source, digest, frame)
        except LabelError as error:
            why = str(error)
            self._fail(source.name, why)
        self._expected[source.name] = len(taken)
        self.store.write_frames(source.name, whole, taken, why)

    def _frame(self, place: int, source: Source, digest: str, frame: VideoFrame) -> Iterator[_Work]:
        """Yield a frame, unless it is finished, or cannot be counted."""
        name = frame_name(source, frame.index)
        if frame.pixels is None:
            done = self._done(source, digest, frame.index)
            assert done is not None
            self._keep(place, done)
            return
        try:
            key, scale = self._key(source, name, digest, frame.index)
            work = self._work(place, name, key, frame.pixels, scale, frame.stored_width)
        except (LabelError, SequenceError) as error:
            self._fail(name, str(error))
            return
        yield replace(work, index=frame.index, time_s=frame.time_s)

    def _all_kept(self, place: int, source: Source, digest: str, frames: Sequence[tuple[int, float]], why: str) -> bool:
        """Keep all frames of a video if every one is finished, so that it need not be decoded; return whether so."""
        held = [self._done(source, digest, index) for index, _ in frames]
        done = [one for one in held if one is not None]
        if len(done) < len(held):
            return False
        self._expected[source.name] = len(done)
        for one in done:
            self._keep(place, one)
        if why:
            self._fail(source.name, why)
        return True

    def _done(self, source: Source, digest: str, index: int) -> PictureCount | None:
        name = frame_name(source, index)
        try:
            return self.store.finished(name, self._key(source, name, digest, index)[0])
        except LabelError:  # no scale is given for it
            return None

    def _key(self, source: Source, name: str, digest: str, index: int | None = None) -> tuple[str, Scale | None]:
        scale = self.settings.scale(source, name)
        values = {
            "method": self.identity,
            "threshold": self.settings.threshold,
            "least": self.settings.least.as_dict(),
            "scale": None if scale is None else scale.as_dict(),
            "picture": digest,
            "frame": index,
        }
        return key_of(values), scale

    def _work(
        self, place: int, name: str, key: str, pixels: Pixels, scale: Scale | None, stored_width: int | None = None
    ) -> _Work:
        height, width = pixels.shape[:2]
        return _Work(place, name, key, pixels, None if scale is None else scale.fitted((height, width), stored_width))

    def _fail(self, name: str, why: str) -> None:
        self.result.failures[name] = why
        self._tell()

    def _keep(self, place: int, picture: PictureCount) -> None:
        """Add a finished image to the result; its file may have been elsewhere when it was counted."""
        self._found[picture.name] = place, replace(picture, file=str(self.sources[place].path))
        self._tell()

    def _tell(self) -> None:
        done = len(self._found) + len(self.result.failures)
        self.progress(done, max(done, sum(self._expected.values())))

    def _films(self) -> None:
        """Write the film of each video, unless it exists already for exactly these overlays."""
        for source in self.sources:
            if not source.video:
                continue
            frames = [one for one in self.result.pictures if one.file == str(source.path)]
            if not frames:
                continue
            overlays = [self.store.overlay(one.name) for one in frames]
            key = key_of({"film": [(path.name, path.stat().st_mtime_ns) for path in overlays]})
            film = self.store.film(source.name)
            if not self.store.film_is_of(source.name, key):
                write_film(film, overlays, film_rate([one.time_s or 0.0 for one in frames]))
                self.store.write_film_key(source.name, key)
            self.result.films[source.name] = film


def frame_name(source: Source, index: int) -> str:
    """Name of a frame of a video: VIDEO/NUMBER.

    >>> frame_name(Source("dive 1.mp4", Path("dive 1.mp4"), True), 30)
    'dive 1.mp4/000030'
    """
    return f"{source.name}/{index:06d}"
