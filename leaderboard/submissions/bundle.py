"""What was sent, opened: poses or commands by sequence, answers by image, or results. Each reading ends in these, or in
a Refusal that names file and line; no truth is needed for it, so that all of it may be told."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from oysterbench.core.errors import OysterbenchError
from oysterbench_leaderboard.submissions.archive import (
    Archive,
    Budget,
    Limits,
    arrays_of,
    in_memory,
    is_zip,
    shown,
)
from oysterbench_leaderboard.submissions.catalogue import Kind, Wanted
from oysterbench_leaderboard.submissions.refusals import Refusal

# A reader of what was sent is started for each submission: what only some kinds need is imported where it is needed.
if TYPE_CHECKING:
    from oysterbench.core.trajectory import Trajectory
    from oysterbench.evaluate.detection import ImageInstances
    from oysterbench.evaluate.segmentation import EstimateImage
    from oysterbench.methods.steering import Steering
    from oysterbench.results.records import ResultRecord

POSES = (".tum", ".txt", ".csv", ".npz")
ANSWERS = (".json", ".npz")
COMMANDS = (".csv",)
FILES: dict[Kind, tuple[str, ...]] = {"poses": POSES, "answers": ANSWERS, "commands": COMMANDS}
"""What is sent -> how the names of files end that answer a whole sequence."""

IMAGE = ".png"


@dataclass(frozen=True)
class Answer:
    """What was said of one image; each is read when it is asked for.

    mask:      of the track segmentation
    instances: single oysters, by a height and width; of a mask what hangs together in it
    """

    mask: Callable[[], EstimateImage]
    instances: Callable[[tuple[int, int]], ImageInstances]


@dataclass(frozen=True)
class Bundle:
    """What was sent. poses: sequence -> reader of its path, by the options that its file leaves open; answers: name of
    an image -> what was said of it; commands: sequence -> reader of those at each of its pictures; results: as they are
    in a results.json."""

    kind: Kind
    poses: dict[str, Callable[..., Trajectory]] = field(default_factory=dict)
    answers: dict[str, Answer] = field(default_factory=dict)
    commands: dict[str, Callable[[], tuple[Steering, ...]]] = field(default_factory=dict)
    results: tuple[ResultRecord, ...] = ()

    def answered(self, wanted: Wanted) -> list[str]:
        """Sequences that something is said of."""
        if self.kind == "poses":
            return [name for name in wanted.sequences if name in self.poses]
        if self.kind == "commands":
            return [name for name in wanted.sequences if name in self.commands]
        if self.kind == "results":
            return sorted({record.sequence for record in self.results})
        found = {name.split("/")[0] for name in self.answers}
        return [name for name in wanted.sequences if name in found]


def open_bundle(path: Path, wanted: Wanted, limits: Limits) -> Bundle:
    """Open what was sent: a zip archive, or one file. What it is says its content; names are only compared with what
    the split has."""
    with open(path, "rb") as file:
        first = file.read(4096)
    if not first:
        raise Refusal("format", "nothing was sent: the upload is empty")
    budget = Budget(limits)
    if is_zip(first):
        return _open_zip(path, wanted, limits, budget)
    size = path.stat().st_size
    if size > limits.file_bytes:
        raise Refusal("size", f"one file has {size} bytes; expected at most {limits.file_bytes // 1_000_000} MB")
    data = path.read_bytes()
    if first.lstrip()[:1] in (b"{", b"["):
        return _open_json(data, wanted, limits)
    if wanted.of_images:
        raise Refusal(
            "type", f"{wanted.track}: expected COCO annotations (.json), arrays (.npz) or PNG masks in a zip archive"
        )
    only = _only(wanted)
    if wanted.kind == "commands":
        return Bundle("commands", commands={only: _commands(data, f"{only}.csv", only, wanted)})
    return Bundle("poses", {only: _poses(data, f"{only}.tum")})


def _open_zip(path: Path, wanted: Wanted, limits: Limits, budget: Budget) -> Bundle:
    archive = Archive(path, "archive", budget, arrays=_looks_like_npz(path))
    if not archive.entries:
        raise Refusal("archive", "the archive holds no file")
    if all(name.endswith(".npy") for name in archive.entries):
        if path.stat().st_size > limits.file_bytes:
            raise Refusal("size", f"expected a file of at most {limits.file_bytes // 1_000_000} MB, got more")
        data = path.read_bytes()
        if wanted.of_images:
            return Bundle("answers", answers=_array_answers(data, "arrays.npz", wanted, Budget(limits), ""))
        if wanted.kind == "commands":
            raise Refusal("type", f"{wanted.track}: expected a table for each sequence (.csv), got arrays")
        return Bundle("poses", {_only(wanted): _poses(data, f"{_only(wanted)}.npz", Budget(limits))})
    bundle = Bundle(wanted.kind)
    for name in archive.entries:
        _open_member(bundle, archive, name, wanted, limits, budget)
    return bundle


def _looks_like_npz(path: Path) -> bool:
    """Whether the first entry is an array: such an archive may shrink as much as it likes."""
    with open(path, "rb") as file:
        head = file.read(512)
    length = int.from_bytes(head[26:28], "little")
    return head[30 : 30 + length].endswith(b".npy")


def _open_member(bundle: Bundle, archive: Archive, name: str, wanted: Wanted, limits: Limits, budget: Budget) -> None:
    place = PurePosixPath(name)
    stem, suffix = place.with_suffix("").as_posix(), place.suffix
    taken = f"{shown(name)}: {stem} is answered by two files; expected one"
    if wanted.of_images and suffix == IMAGE:
        _check_image(stem, wanted, name)
        if stem in bundle.answers:
            raise Refusal("name", taken)
        bundle.answers[stem] = _mask_answer(stem, lambda: _png(archive.read(name), name), wanted)
        return
    allowed = FILES[wanted.kind]
    if suffix not in allowed or stem not in wanted.sequences:
        sequences = ", ".join(wanted.sequences[:3]) + (", ..." if len(wanted.sequences) > 3 else "")
        images = f", or {wanted.sequences[0]}/CAMERA/STAMP.png" if wanted.of_images else ""
        raise Refusal(
            "name",
            f"{shown(name)} is no name of {wanted.split}; expected SEQUENCE{'|'.join(allowed)}{images}, the sequences "
            f"being {sequences}, with no folder around them",
        )
    if wanted.kind == "commands":
        bundle.commands[stem] = _commands(archive.read(name), name, stem, wanted)
        return
    if not wanted.of_images:
        if stem in bundle.poses:
            raise Refusal("name", taken)
        bundle.poses[stem] = _poses(archive.read(name), name, budget if suffix == ".npz" else None)
        return
    data = archive.read(name)
    arrays = suffix == ".npz"
    found = _array_answers(data, name, wanted, budget, stem) if arrays else _coco_answers(data, name, wanted)
    for image, answer in found.items():
        if image in bundle.answers or image.split("/")[0] != stem:
            raise Refusal("name", f"{name}: {shown(image)} is answered twice, or not of {stem}")
        bundle.answers[image] = answer


def _only(wanted: Wanted) -> str:
    if len(wanted.sequences) > 1:
        raise Refusal(
            "name",
            f"{wanted.split} has {len(wanted.sequences)} sequences, and one file does not say of which it is; expected "
            f"a zip archive with a file for each, named {wanted.sequences[0]}.tum and so on",
        )
    return wanted.sequences[0]


# Poses:


def _poses(data: bytes, label: str, budget: Budget | None = None) -> Callable[..., Trajectory]:
    """budget: of an .npz, which is an archive of its own."""
    if budget is not None:
        if not is_zip(data):
            raise Refusal("format", f"{label}: not an .npz of numpy arrays")
        arrays_of(data, label, budget)

    def read(**options: Any) -> Trajectory:
        from oysterbench.core.trajectory import ReadOptions
        from oysterbench.core.trajectory.archive import read_npz
        from oysterbench.core.trajectory.text import read_text
        from oysterbench.evaluate.slam.validate import check_trajectory

        with told(label):
            read = read_text if budget is None else read_npz
            found = read(Path(label), data, ReadOptions(**options))
        with told(label, prefix=True):
            check_trajectory(found, "estimate")
        return found

    return read


def _commands(data: bytes, label: str, sequence: str, wanted: Wanted) -> Callable[[], tuple[Steering, ...]]:
    from oysterbench_leaderboard.submissions.commands import reader

    return reader(data, label, sequence, wanted)


class told:
    """Turns errors of readers into refusals in the sender's words: `path`, wherever the bytes lay, becomes `label`."""

    def __init__(self, label: str, path: Path | None = None, prefix: bool = False) -> None:
        self.label, self.path, self.prefix = label, path, prefix

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if error is None or isinstance(error, Refusal):
            return
        if isinstance(error, OysterbenchError):
            text = " ".join(str(error).split())
            if self.path is not None:
                text = text.replace(str(self.path), self.label)
            raise Refusal("format", f"{self.label}: {text}" if self.prefix else text) from None
        if isinstance(error, MemoryError | RecursionError):
            raise Refusal("format", f"{self.label}: its content claims to be larger than can be read here") from None


# Images:


def _check_image(name: str, wanted: Wanted, file: str) -> None:
    sequence = name.split("/")[0]
    if sequence not in wanted.sequences or (wanted.images and name not in wanted.images[sequence]):
        named = next((image for images in wanted.images.values() for image in images), f"{wanted.sequences[0]}/...")
        raise Refusal("name", f"{shown(file)} names no image of {wanted.split}; its images are named as {named}")


def _check_shape(name: str, shape: tuple[int, ...], wanted: Wanted, where: str) -> None:
    size = wanted.images.get(name.split("/")[0], {}).get(name)
    if size is not None and tuple(shape) != tuple(size):
        got = " x ".join(str(n) for n in shape[::-1])
        raise Refusal("format", f"{where}: expected {size[1]} x {size[0]} pixels, as the image has, got {got}")


def _png(data: bytes, label: str) -> Any:
    from oysterbench.annotations.masks import read_png

    if data[:8] != b"\x89PNG\r\n\x1a\n" or len(data) < 33:
        raise Refusal("format", f"{shown(label)}: not a PNG file")
    width, height = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if not 0 < width * height <= 1 << 26:  # before anything of that size is made
        raise Refusal("format", f"{shown(label)}: {width} x {height} pixels are more than any image here has")
    with in_memory(data, label) as path, told(label, path):
        return read_png(path)


def _mask_answer(name: str, read: Callable[[], Any], wanted: Wanted) -> Answer:
    from oysterbench.annotations import MaskFiles

    def mask() -> EstimateImage:
        with told(name):
            found = MaskFiles(Path("answer"), {name: read}, "auto").get(name)
        values = next(v for v in (found.oyster, found.probability, found.classes) if v is not None)
        _check_shape(name, values.shape, wanted, name)
        return found

    def instances(shape: tuple[int, int]) -> ImageInstances:
        from oysterbench.evaluate.detection import DetectionSettings
        from oysterbench.methods.images import Segmentation
        from oysterbench.tracks.image_predictions import instances_of

        found = mask()
        answer = Segmentation(found.name, found.oyster, found.probability, found.classes)
        return instances_of(answer, name, shape, DetectionSettings().threshold)

    return Answer(mask, instances)


def _array_answers(data: bytes, label: str, wanted: Wanted, budget: Budget, sequence: str) -> dict[str, Answer]:
    import numpy as np

    archive = arrays_of(data, label, budget)

    def reader(key: str, name: str) -> Callable[[], Any]:
        def read() -> Any:
            try:
                return np.lib.format.read_array(io.BytesIO(archive.read(key)), allow_pickle=False)
            except (ValueError, EOFError, SyntaxError, TypeError, MemoryError, OverflowError) as error:
                said = " ".join(str(error).split())[:120]
                raise Refusal("format", f"{label}: array {shown(name)} cannot be read: {said}") from None

        return read

    found = {}
    for key in archive.entries:
        name = key.removesuffix(".npy")
        _check_image(name, wanted, name)
        if sequence and name.split("/")[0] != sequence:
            raise Refusal("name", f"{label}: {shown(name)} is not of {sequence}")
        found[name] = _mask_answer(name, reader(key, name), wanted)
    return found


def _coco_answers(data: bytes, label: str, wanted: Wanted) -> dict[str, Answer]:
    from oysterbench.annotations import read_coco
    from oysterbench.evaluate.segmentation import SegmentationSettings

    with in_memory(data, label) as path, told(label, path):
        file = read_coco(path)
        place = path
    for name, size in file.sizes.items():
        _check_image(name, wanted, name)
        _check_shape(name, size, wanted, f"{label}: {name}")

    def answer(name: str) -> Answer:
        def mask() -> EstimateImage:
            with told(label, place):
                return file.mask(name, SegmentationSettings().threshold)

        def instances(shape: tuple[int, int]) -> ImageInstances:
            with told(label, place):
                return file.instances(name, scored=True)

        return Answer(mask, instances)

    return {name: answer(name) for name in file.names}


# JSON: annotations, or results:


def _open_json(data: bytes, wanted: Wanted, limits: Limits) -> Bundle:
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise Refusal("format", f"upload.json: not valid JSON: {' '.join(str(error).split())[:120]}") from None
    if isinstance(content, dict) and "results" in content:
        from oysterbench_leaderboard.submissions.reported import read_results

        return Bundle("results", results=read_results(data, content, wanted, limits))
    if not wanted.of_images:
        what = "paths (TUM, EuRoC, CSV, .npz)" if wanted.kind == "poses" else "tables of commands (.csv)"
        raise Refusal("type", f"upload.json: {wanted.track}: expected {what}, or results with 'results'")
    return Bundle("answers", answers=_coco_answers(data, "upload.json", wanted))


def check_bundle(bundle: Bundle, wanted: Wanted) -> dict[str, Any]:
    """Read all of it once. Raises Refusal, by file and line, where something cannot be scored; what it holds, in
    numbers."""
    poses = images = 0
    for read in bundle.poses.values():
        poses += len(read())
    images += sum(len(read()) for read in bundle.commands.values())
    sequences = bundle.answered(wanted)
    for sequence in sequences if bundle.kind == "answers" and wanted.images else ():
        missing = [name for name in wanted.images[sequence] if name not in bundle.answers]
        if missing:
            raise Refusal(
                "format",
                f"{sequence}: {len(missing)} of {len(wanted.images[sequence])} images are not answered, the first "
                f"being {missing[0]}; expected all of a sequence, or none",
            )
    for name, answer in _in_order(bundle):
        images += 1
        if wanted.track == "segmentation":
            answer.mask()
        else:
            with told(name):
                answer.instances(wanted.images.get(name.split("/")[0], {}).get(name, (1, 1)))
    return {"kind": bundle.kind, "sequences": sequences, "poses": poses, "images": images}


def _in_order(bundle: Bundle) -> Iterator[tuple[str, Answer]]:
    return iter(sorted(bundle.answers.items()))
