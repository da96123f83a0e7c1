"""Opening an upload: it gives readers of paths or commands by sequence, readers of masks or instances by image, or
results. A failed reading raises a Refusal that names file and line; no ground truth is involved, so its message may be
shown in full."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from oysterbench.core.errors import OysterbenchError
from oysterbench.core.text import in_one_line, read_json
from oysterbench_leaderboard.submissions.catalogue import Kind, Wanted
from oysterbench_leaderboard.submissions.reading.archive import (
    Archive,
    Budget,
    Limits,
    arrays_of,
    in_memory,
    is_zip,
    shown,
)
from oysterbench_leaderboard.submissions.reading.refusals import Refusal, without_options

# A reader process is started for each submission: what only some kinds of upload need is imported lazily.
if TYPE_CHECKING:
    from oysterbench.annotations import MaskFiles
    from oysterbench.core.trajectory import Trajectory
    from oysterbench.evaluate.detection import ImageInstances
    from oysterbench.evaluate.segmentation import EstimateImage
    from oysterbench.methods.steering import Steering
    from oysterbench.results.records import ResultRecord
    from oysterbench.tracks.images import ImageTrack

IMAGE = ".png"

Reader = Callable[..., Any]
"""Reads a prediction when it is called. For a path: takes the options that its file leaves open, and returns a
Trajectory; for a table of commands: returns a list of Steering, one for each image; for an image: returns an
EstimateImage (segmentation) or ImageInstances (detection)."""


@dataclass(frozen=True)
class Plane:
    """A mask as it was sent, an array (H, W), which is read when `read` is called."""

    read: Callable[[], Any]


LONGEST_LINE = 4000
"""Maximum length of a line of text, bytes: a pose with its covariance has a thousand."""


@dataclass(frozen=True)
class Predictions:
    """Contents of an upload. readers: by sequence, or by image name; results: as in a results.json."""

    kind: Kind
    readers: Mapping[str, Reader] = field(default_factory=dict)
    results: tuple[ResultRecord, ...] = ()

    def sequences(self, wanted: Wanted) -> list[str]:
        """Sequences that the upload has predictions or results for."""
        if self.kind == "results":
            return sorted({record.sequence for record in self.results})
        found = {name.partition("/")[0] for name in self.readers}
        return [name for name in wanted.sequences if name in found]


def open_upload(path: Path, wanted: Wanted, limits: Limits) -> Predictions:
    """Open an upload: a zip archive, or one file. Its type is found from its content; names are only compared with
    those of the split. Raises Refusal."""
    with open(path, "rb") as file:
        first = file.read(4096)
    if not first:
        raise Refusal("format", "nothing was sent: the upload is empty")
    size = path.stat().st_size
    suffix = ".csv" if wanted.kind == "commands" else ".tum"
    if is_zip(first):
        suffix, budget = ".npz", Budget(limits)
        archive = Archive(path, "archive", budget, arrays=_begins_with_array(first))
        if not archive.entries:
            raise Refusal("archive", "the archive holds no file")
        if not all(name.endswith(".npy") for name in archive.entries):
            return Predictions(wanted.kind, _readers(_members(archive, wanted, budget), wanted))
    if size > limits.file_bytes:
        raise Refusal("size", f"one file has {size} bytes; expected at most {limits.file_bytes // 1_000_000} MB")
    data = path.read_bytes()
    if first.lstrip()[:1] in (b"{", b"["):
        suffix = ".json"
        try:
            content = read_json(data)
        except ValueError as error:
            raise Refusal("format", f"upload.json: not valid JSON: {in_one_line(error, 120)}") from None
        if isinstance(content, dict) and "results" in content:
            from oysterbench_leaderboard.submissions.reading.reported import read_reported

            return Predictions("results", results=read_reported(data, content, wanted, limits))
    opener = OPENERS[wanted.kind].get(suffix)
    if opener is None:
        got = {".npz": "arrays", ".json": "JSON without 'results'"}.get(suffix, "text")
        raise Refusal("type", f"{wanted.track}: expected {SENT[wanted.kind]}, got {got}")
    if wanted.of_images:
        opened = opener(lambda: data, f"upload{suffix}", "", wanted, Budget(limits))
        return Predictions(wanted.kind, _readers(opened, wanted))
    if len(wanted.sequences) > 1:
        raise Refusal(
            "name",
            f"{wanted.split} has {len(wanted.sequences)} sequences, and one file does not say which one it is for; "
            "expected "
            f"a zip archive with a file for each, named {wanted.sequences[0]}.tum and so on",
        )
    (only,) = wanted.sequences
    opened = opener(lambda: data, f"{only}{suffix}", only, wanted, Budget(limits))
    return Predictions(wanted.kind, _readers(opened, wanted))


def _begins_with_array(first: bytes) -> bool:
    """Whether the first entry of a zip archive is an array; such an archive may have any compression ratio."""
    length = int.from_bytes(first[26:28], "little")
    return first[30 : 30 + length].endswith(b".npy")


def _members(archive: Archive, wanted: Wanted, budget: Budget) -> dict[str, Reader | Plane]:
    openers = OPENERS[wanted.kind]
    found: dict[str, Reader | Plane] = {}
    for name in archive.entries:
        place = PurePosixPath(name)
        stem, suffix = place.with_suffix("").as_posix(), place.suffix
        if suffix not in openers or (suffix != IMAGE and stem not in wanted.sequences):
            sequences = ", ".join(wanted.sequences[:3]) + (", ..." if len(wanted.sequences) > 3 else "")
            images = f", or {wanted.sequences[0]}/CAMERA/STAMP{IMAGE}" if IMAGE in openers else ""
            suffixes = "|".join(suffix for suffix in openers if suffix != IMAGE)
            raise Refusal(
                "name",
                f"{shown(name)} is no name of {wanted.split}; expected SEQUENCE{suffixes}{images}, the sequences being "
                f"{sequences}, with no folder around them",
            )
        for key, reader in openers[suffix](partial(archive.read, name), name, stem, wanted, budget).items():
            if key in found:
                raise Refusal("name", f"{shown(name)}: {shown(key)} is in two files; expected it in one")
            found[key] = reader
    return found


@contextmanager
def refusing(label: str, path: Path | None = None, prefix: bool = False) -> Iterator[None]:
    """Turn errors of readers into refusals that the sender understands: `path`, where the bytes were, is replaced by
    `label`. prefix: whether to put `label` before the message."""
    try:
        yield
    except Refusal:
        raise
    except OysterbenchError as error:
        text = without_options(" ".join(str(error).split()))
        if path is not None:
            text = text.replace(str(path), label)
        raise Refusal("format", f"{label}: {text}" if prefix else text) from None
    except (MemoryError, RecursionError):
        raise Refusal("format", f"{label}: its content claims to be larger than can be read here") from None


# Paths and commands:


def _check_text(data: bytes, label: str, budget: Budget) -> None:
    """Refuse text that would take long to parse: too many lines, or lines that are too long."""
    lines = data.splitlines()
    if len(lines) > budget.limits.lines:
        raise Refusal("size", f"{shown(label)}: expected at most {budget.limits.lines} lines, got {len(lines)}")
    if (longest := max(map(len, lines), default=0)) > LONGEST_LINE:
        raise Refusal("format", f"{shown(label)}: expected lines of at most {LONGEST_LINE} bytes, got {longest}")


def _path(read: Callable[[], bytes], label: str, sequence: str, wanted: Wanted, budget: Budget) -> dict[str, Reader]:
    data = read()
    arrays = label.endswith(".npz")
    if arrays:
        if not is_zip(data):
            raise Refusal("format", f"{label}: not an .npz of numpy arrays")
        arrays_of(data, label, budget)
    else:
        _check_text(data, label, budget)

    def trajectory(**options: Any) -> Trajectory:
        from oysterbench.core.trajectory import ReadOptions
        from oysterbench.core.trajectory.archive import read_npz
        from oysterbench.core.trajectory.text import read_text
        from oysterbench.evaluate.slam.validate import check_trajectory
        from oysterbench_leaderboard.submissions.reading.times import check_times

        with refusing(label):
            found = (read_npz if arrays else read_text)(Path(label), data, ReadOptions(**options))
        with refusing(label, prefix=True):
            check_trajectory(found, "estimate")
        if sequence in wanted.spans:
            check_times(found, label, sequence, wanted.spans[sequence])
        return found

    return {sequence: trajectory}


def _commands(
    read: Callable[[], bytes], label: str, sequence: str, wanted: Wanted, budget: Budget
) -> dict[str, Reader]:
    data = read()
    _check_text(data, label, budget)

    def commands() -> list[Steering]:
        from oysterbench.methods.interfaces.steering import parse_commands

        assert wanted.task is not None, wanted.split  # of a split of the track steering
        stamps = sorted(int(name.rpartition("/")[2]) for name in wanted.images.get(sequence, {}))
        with refusing(label):
            return parse_commands(data, label, wanted.task, stamps)

    return {sequence: commands}


# Images:


def _check_image(name: str, wanted: Wanted, file: str, sequence: str = "") -> None:
    """Refuse a name that is no image of the split. sequence: the one that all images in the file must belong to; empty
    for any."""
    of = name.partition("/")[0]
    if of not in wanted.sequences or (wanted.images and name not in wanted.images[of]):
        named = next((image for images in wanted.images.values() for image in images), f"{wanted.sequences[0]}/...")
        raise Refusal("name", f"{shown(file)} names no image of {wanted.split}; its images are named as {named}")
    if sequence and of != sequence:
        raise Refusal("name", f"{file}: {shown(name)} is not of {sequence}")


def _check_shape(name: str, shape: tuple[int, ...], wanted: Wanted, where: str) -> None:
    size = wanted.size(name)
    if size is not None and tuple(shape) != size:
        got = " x ".join(str(n) for n in shape[::-1])
        raise Refusal("format", f"{where}: expected {size[1]} x {size[0]} pixels, as the image has, got {got}")


def _png(read: Callable[[], bytes], label: str, name: str, wanted: Wanted, budget: Budget) -> dict[str, Plane]:
    """Plane of a mask in a file of its own, which is read from the archive on demand."""
    _check_image(name, wanted, label)

    def pixels() -> Any:
        from oysterbench.annotations.masks import read_png

        with in_memory(read(), label) as path, refusing(shown(label), path):
            return read_png(path)

    return {name: Plane(pixels)}


def _arrays(read: Callable[[], bytes], label: str, sequence: str, wanted: Wanted, budget: Budget) -> dict[str, Plane]:
    """Planes of an .npz with one mask per image."""
    import numpy as np

    archive = arrays_of(read(), label, budget)

    def pixels(name: str) -> Any:
        data = archive.read(f"{name}.npy")
        try:
            return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
        except Exception as error:  # an array's header is evaluated, and may raise anything
            raise Refusal("format", f"{label}: array {shown(name)} cannot be read: {in_one_line(error, 120)}") from None

    names = [key.removesuffix(".npy") for key in archive.entries]
    for name in names:
        _check_image(name, wanted, name, sequence)
    return {name: Plane(partial(pixels, name)) for name in names}


def _readers(found: Mapping[str, Reader | Plane], wanted: Wanted) -> dict[str, Reader]:
    """Readers of all that was found. What the values of masks mean is judged by all masks of the upload together, as
    `oysterbench eval` judges a folder."""
    planes = {name: one.read for name, one in found.items() if isinstance(one, Plane)}

    @cache
    def files() -> MaskFiles:
        from oysterbench.annotations import MaskFiles

        return MaskFiles(Path("upload"), planes, "auto")

    def prediction(name: str) -> EstimateImage | ImageInstances:
        track = image_track(wanted.track)
        with refusing(name):
            shape = files().plane(name).shape
            _check_shape(name, shape, wanted, name)
            taken: EstimateImage | ImageInstances = track.of_masks(
                files(), name, wanted.size(name) or shape, track.settings({})
            )
            return taken

    return {name: partial(prediction, name) if isinstance(one, Plane) else one for name, one in found.items()}


def image_track(name: str) -> ImageTrack:
    """Return an image track by its name."""
    from oysterbench.tracks import TRACKS
    from oysterbench.tracks.images import ImageTrack

    track = TRACKS[name]
    assert isinstance(track, ImageTrack), name
    return track


def _coco(read: Callable[[], bytes], label: str, sequence: str, wanted: Wanted, budget: Budget) -> dict[str, Reader]:
    """Readers of COCO annotations of any number of images."""
    from oysterbench.annotations import read_coco

    with in_memory(read(), label) as path, refusing(label, path):
        file = read_coco(path)
        place = path
    for name, size in file.sizes.items():
        _check_image(name, wanted, name)
        _check_shape(name, size, wanted, f"{label}: {name}")
    most = budget.limits.annotations
    for name, items in file.items.items():
        _check_image(name, wanted, label, sequence)
        if len(items) > most:
            raise Refusal("size", f"{label}: {name}: expected at most {most} annotations of an image, got {len(items)}")

    track = image_track(wanted.track)

    def prediction(name: str) -> Any:
        with refusing(label, place):
            return track.of_coco(file, name, track.settings({}))

    return {name: partial(prediction, name) for name in file.names}


Opener = Callable[[Callable[[], bytes], str, str, Wanted, Budget], Mapping[str, Reader | Plane]]
"""Takes a function that reads the file, the file's name, the name without suffix, what is wanted, and the budget for
unpacking."""

OPENERS: dict[Kind, dict[str, Opener]] = {
    "poses": {".tum": _path, ".txt": _path, ".csv": _path, ".npz": _path},
    "predictions": {".json": _coco, ".npz": _arrays, IMAGE: _png},
    "commands": {".csv": _commands},
}
"""Kind of upload -> suffix of a file -> its opener. All files but single masks are named by their sequence."""

SENT: dict[Kind, str] = {
    "poses": "paths (TUM, EuRoC, CSV, .npz), or a results.json",
    "predictions": "COCO annotations (.json), arrays (.npz) or PNG masks in a zip archive, or a results.json",
    "commands": "tables of commands (.csv), one for each sequence, or a results.json",
}
"""Kind of upload -> description of the files it takes."""


def check_predictions(predictions: Predictions, wanted: Wanted) -> dict[str, Any]:
    """Read everything in an upload; return its counts, and notes for its sender. Raises Refusal where something cannot
    be read, or a sequence has predictions for only some of its images."""
    sequences = predictions.sequences(wanted)
    of_images = sequences if predictions.kind == "predictions" else []
    for sequence in of_images if not wanted.images else ():
        count = sum(name.partition("/")[0] == sequence for name in predictions.readers)
        if count != (expected := wanted.counts.get(sequence, count)):
            raise Refusal("format", f"{sequence}: expected predictions for {expected} images, got {count}")
    for sequence in of_images if wanted.images else ():
        if missing := [name for name in wanted.images[sequence] if name not in predictions.readers]:
            raise Refusal(
                "format",
                f"{sequence}: {len(missing)} of {len(wanted.images[sequence])} images have no prediction, the first "
                f"being {missing[0]}; expected all of a sequence, or none",
            )
    poses = images = 0
    notes = []
    for name, read in sorted(predictions.readers.items()):
        found = read()
        if predictions.kind == "poses":
            from oysterbench_leaderboard.submissions.reading.times import outside_notes

            poses += len(found)
            notes += outside_notes(found, name, wanted.spans.get(name))
        else:
            images += 1 if predictions.kind == "predictions" else len(found)
    return {"kind": predictions.kind, "sequences": sequences, "poses": poses, "images": images, "notes": notes}
