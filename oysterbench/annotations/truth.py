"""Ground truth by clip and image: from rendered sequences, labelled folders, plain folders of masks, or COCO."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.coco import CocoFile, read_coco
from oysterbench.annotations.coco_set import coco_files, picture_file, read_coco_picture
from oysterbench.annotations.image import Entry, is_colour, planes_of
from oysterbench.annotations.label_images import check_no_masks, png_files
from oysterbench.annotations.manifest import FILE, read_manifest, scored_sides
from oysterbench.annotations.masks import as_mask, read_png
from oysterbench.annotations.opening import NONE, got_at, kinds_at, open_labelled
from oysterbench.annotations.yolo_boxes import boxes_at
from oysterbench.core.errors import LabelError
from oysterbench.core.geometry import Array
from oysterbench.core.places import shown
from oysterbench.evaluate.detection import ImageInstances
from oysterbench.evaluate.detection.instances import from_planes
from oysterbench.evaluate.segmentation import TruthImage
from oysterbench.recipe import CLASSES, OYSTER
from oysterbench.sequence import CameraCalibration, Sequence, open_sequence
from oysterbench.sequence.countable import countable
from oysterbench.sequence.export.parts import frames_with_layers, labelled_cameras, sensor_poses
from oysterbench.sequence.export.ply import points_at, rays_at

IGNORED = 255
"""Value of pixels to be ignored in class images."""

TRUTH_KINDS = (
    "for a number to be ignored give --ignore-value, for classes --truth-kind classes; numbers of oysters belong in "
    "COCO annotations (as `oysterbench segment --coco` writes them), or in instances/ beside images/ and masks/"
)
"""What to do about a true mask of several numbers."""

GRID = 16  # px between the rays from which the area of seabed in an image is computed

Seen = tuple[TruthImage, NDArray[np.uint8] | None]
"""Truth of an image and its pixels (H, W, 3) uint8 RGB, if there are any."""


@dataclass(frozen=True)
class LabelledSequence:
    """Images of one recording. names: of all of them, known without reading any; images: reads them one by one.

    digest: of the files of the truth; coco: set if it is COCO annotations, whose instances may overlap. pixels: reads
    the image of a name, without the truth, None if only `images` reads them; pictures_at: the files that it reads
    sides: which sides of the data are scored, as a sentence; empty where there are none. unscored: names of the images
    of other sides
    """

    name: str
    names: tuple[str, ...]
    images: Callable[[], Iterator[Seen]]
    digest: str
    conditions: Mapping[str, float | str] = field(default_factory=dict)
    coco: CocoFile | None = None
    pixels: Callable[[str], NDArray[np.uint8] | None] | None = None
    pictures_at: tuple[Path, ...] = ()
    sides: str = ""
    unscored: frozenset[str] = frozenset()

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of the metrics of single oysters should know, in sentences."""
        lacking = "" if self.coco is None else self.coco.without_mask
        why = f"no metrics of masks, as oysters of the ground truth have a box alone: {lacking}; outline or remove them"
        return (why,) if lacking else ()

    def pictures(self) -> Iterator[tuple[str, NDArray[np.uint8] | None]]:
        """Yield name and pixels of each image; of COCO annotations, also where the truth has boxes without masks."""
        if self.pixels is None:
            yield from ((truth.name, pixels) for truth, pixels in self.images())
        else:
            yield from ((name, self.pixels(name)) for name in self.names)

    def shown(self, name: str, pixels: NDArray[np.uint8] | None) -> NDArray[np.uint8] | None:
        """Return the pixels of an image for a report: those that `images` gave, or of COCO annotations, for which it
        gives none, those of its file; None where this is not as the annotations say, as no score depends on it."""
        try:
            return pixels if self.pixels is None else self.pixels(name)
        except LabelError:
            return None

    def digest_given(self) -> str:
        """SHA-256 of all that methods are given and scored by: of the truth, of image files beside it, and of names."""
        beside = [_digest([path]) for path in self.pictures_at]
        known = "\0".join((self.digest, *beside, *self.names))
        return hashlib.sha256(known.encode(errors="surrogateescape")).hexdigest()

    def instances(self, truth: TruthImage) -> ImageInstances:
        """Return the single oysters of one of the images. Raises LabelError if the truth does not separate them."""
        if self.coco is not None:
            return self.coco.instances(truth.name, scored=False)
        if truth.instances is None:
            raise LabelError(
                f"{truth.name}: the ground truth is a mask, which does not separate individual oysters; expected COCO "
                "annotations, YOLO polygons, masks with instances/, or sequences"
            )
        numbers = np.where(truth.oyster, truth.instances, 0)
        return from_planes(truth.name, numbers, truth.ignore, truth.footprint_m2, live=truth.live)

    def check_annotations(self, masks: bool) -> None:
        """Read all COCO annotations that are scored, as methods are given images without them. masks: whether masks are
        scored, which each must then have, and not boxes. Raises LabelError naming the annotation that is wrong."""
        if self.coco is None:
            return
        for name in self.names:
            if not masks:
                self.coco.instances(name, scored=False)
            for _ in self.coco.truth(name)[0] if masks else ():
                pass

    def single(self) -> Iterator[tuple[ImageInstances, Seen | None]]:
        """Yield the single oysters of each image, with its truth and pixels; None for these if the truth has boxes
        without masks."""
        if self.coco is not None and self.coco.boxes_alone:
            yield from ((self.coco.instances(name, scored=False), None) for name in self.names)
            return
        for truth, pixels in self.images():
            yield self.instances(truth), (truth, pixels)


def labelled_sequence(path: Path, conditions: Mapping[str, float | str] | None = None) -> LabelledSequence:
    """Open the frames of all cameras of a sequence with the layers class and instance. Oysters that are hardly visible
    are ignored (`sequence.countable`); depth, shell heights and the area of seabed in view are included if known."""
    sequence = open_sequence(path)
    cameras = labelled_cameras(sequence, "visibility", "depth")
    if not cameras:
        raise LabelError(
            f"{path}: no camera has the layers class and instance; `oysterbench info {path}` lists what there is"
        )
    names = [f"{sequence.name}/{c}/{frame.stamp_ns}" for c in cameras for frame in sequence.layer(c, "class")]
    return LabelledSequence(
        sequence.name,
        tuple(names),
        lambda: _frames(sequence, cameras),
        _digest([path]),
        conditions or {},
    )


def _frames(sequence: Sequence, cameras: Mapping[str, list[str]]) -> Iterator[Seen]:
    heights, live = _heights_mm(sequence), {number: float(alive) for number, alive in sequence.living().items()}
    trajectory, true = sequence.truth(), sequence.truly_calibrated()
    for camera, layers in cameras.items():
        calibration = true.cameras[camera]
        rays = footprint_rays(calibration)
        poses = sensor_poses(trajectory, calibration.T_base_cam)
        for image, found in frames_with_layers(sequence, camera, layers):
            instances, ignore = countable(found["class"], found["instance"], found.get("visibility"))
            depth = found.get("depth")
            k = int(np.abs(trajectory.stamps_ns - calibration.taken_ns(image.stamp_ns)).argmin())
            yield (
                TruthImage(
                    f"{sequence.name}/{camera}/{image.stamp_ns}",
                    found["class"],
                    ignore=ignore if ignore.any() else None,
                    depth_m=depth,
                    instances=instances,
                    heights_mm=heights,
                    footprint_m2=None if depth is None else footprint_m2(depth, rays, poses[k]),
                    live=live,
                ),
                image.pixels,
            )


def _heights_mm(sequence: Sequence) -> Array | None:
    """Shell heights (N,) in mm by the numbers of the oysters, NaN where there is none; None if no height is known."""
    oysters = sequence.oysters()
    if "height_m" not in oysters:
        return None
    found = np.full(int(oysters["id"].max()) + 1 if len(oysters) else 1, np.nan)
    found[oysters["id"].to_numpy()] = 1000 * oysters["height_m"].to_numpy()
    return found


def footprint_rays(camera: CameraCalibration) -> Array:
    """Rays (R, C, 3) of a camera's pixels, as from `pixel_rays`, on a coarse grid that reaches the image's corners."""
    columns, rows = np.meshgrid(_grid(camera.width), _grid(camera.height))
    return rays_at(camera, columns.astype(float), rows.astype(float))


def _grid(size: int) -> NDArray[np.int64]:
    return np.append(np.arange(0, size - 1, GRID), size - 1)


def footprint_m2(depth_m: NDArray[np.float32], rays: Array, T_map_camera: Array) -> float | None:
    """Area, m^2 seen from above, of the ground that an image shows: sum over the patches of a grid of rays
    (`footprint_rays`) whose four corners all have a depth (H, W), m along the optical axis. None if no patch has."""
    depth = depth_m[np.ix_(_grid(depth_m.shape[0]), _grid(depth_m.shape[1]))].astype(float)
    depth = np.where(np.isfinite(rays[..., 0]), depth, 0.0)
    points = points_at(rays.reshape(-1, 3), depth.ravel()).reshape(*depth.shape, 3)
    east, north = np.moveaxis(points @ T_map_camera[:2, :3].T, -1, 0)
    a = (east[1:, 1:] - east[:-1, :-1]) * (north[1:, :-1] - north[:-1, 1:])
    b = (east[1:, :-1] - east[:-1, 1:]) * (north[1:, 1:] - north[:-1, :-1])
    known = (depth > 0)[1:, 1:] & (depth > 0)[:-1, :-1] & (depth > 0)[1:, :-1] & (depth > 0)[:-1, 1:]
    area = float(np.abs(0.5 * (a - b))[known].sum())
    return area if area > 0 else None


def open_truth(place: Path, labels: str = "mask", ignore_value: int | None = None) -> list[LabelledSequence]:
    """Open the clips at a path: sequences, labelled folders (`opening.KINDS`), YOLO folders of boxes, COCO annotations
    with or without their images, or a plain folder of PNG files, masks or (labels="classes") class numbers.

    Clips of a plain folder are its subfolders, or as given in its manifest.csv (id, clip). Of data with a side
    test, only that is opened. ignore_value: value of pixels to be ignored; for classes 255 by default. Raises
    LabelError where a folder could be one of masks or of COCO annotations.
    """
    kinds = kinds_at(place)
    if kinds == ["coco"]:
        (path,) = [place] if place.is_file() else coco_files(place)
        file = read_coco(path)
        beside = {image.name: found for image in file.images.values() if (found := picture_file(path, image))}
        if place.is_dir() and path.parent != place and not (place / "images").is_dir():
            check_no_masks(place, path, (image.file_name for image in file.images.values()), beside.values())
        return _coco_clips(file, beside, place.stem if place.is_file() else place.resolve().name, [path])
    if kinds == ["yolo"] and (boxes := boxes_at(place)):
        file, beside, labelled = boxes
        return _coco_clips(file, beside, place.resolve().name, labelled)
    sequences = [place] if place.suffix == ".mcap" else shown(place, "*.mcap")
    if place.is_dir() and not (place / "images").is_dir() and not kinds:
        return _plain_clips(place, labels, ignore_value)
    if sequences:
        return [labelled_sequence(path) for path in sequences]
    return _labelled_clips(place)


def _labelled_clips(place: Path) -> list[LabelledSequence]:
    found = open_labelled(place)
    unscored, sides = scored_sides({entry.name: entry.split for entry in found.entries})
    found = found.where(lambda entry: entry.name not in unscored)
    if all(entry.clip == entry.name for entry in found.entries):  # no clips are known
        groups = {found.name: list(found.entries)}
    else:
        groups = {clip: [entry for entry in found.entries if entry.clip == clip] for clip in found.clips}

    def images(entries: list[Entry]) -> Iterator[Seen]:
        for entry in entries:
            image = entry.read()
            ignore = image.ignore if image.ignore.any() else None
            live = {number: float(alive) for number, alive in image.living.items()}
            truth = TruthImage(image.name, image.classes, False, ignore, instances=image.instances, live=live)
            yield truth, image.pixels

    return [
        LabelledSequence(
            clip,
            tuple(entry.name for entry in entries),
            partial(images, entries),
            _digest([path for entry in entries for path in entry.files]),
            sides=sides,
            unscored=unscored,
        )
        for clip, entries in groups.items()
    ]


def _coco_clips(file: CocoFile, beside: Mapping[str, Path], whole: str, labelled: list[Path]) -> list[LabelledSequence]:
    """The clips of annotations; without any, all is one, named `whole`. beside: image files by the names of the images,
    of those that are there; labelled: the files of the annotations."""
    own = {image.name: image for image in file.images.values()}
    unscored, sides = scored_sides({name: image.split for name, image in own.items()})
    digest = _digest(labelled)
    groups: dict[str, list[str]] = {}
    for name in (name for name in own if name not in unscored):
        groups.setdefault(own[name].clip or whole, []).append(name)

    def pixels(name: str) -> NDArray[np.uint8] | None:
        return read_coco_picture(beside[name], own[name]) if name in beside else None

    def images(names: list[str]) -> Iterator[Seen]:
        for name in names:
            oysters, crowd = file.truth(name)
            classes, instances = planes_of(oysters, *crowd.shape)
            ignore = crowd & (classes != OYSTER)
            truth = TruthImage(name, classes, False, ignore if ignore.any() else None, instances=instances)
            yield truth, None  # images are read where one is shown, or a method runs

    return [
        LabelledSequence(
            clip,
            tuple(names),
            partial(images, names),
            digest,
            coco=file,
            pixels=pixels,
            pictures_at=tuple(beside[name] for name in names if name in beside),
            sides=sides,
            unscored=unscored,
        )
        for clip, names in groups.items()
    ]


def _plain_clips(place: Path, labels: str, ignore_value: int | None) -> list[LabelledSequence]:
    found = png_files(place)
    files = {path.relative_to(place).with_suffix("").as_posix(): path for path in found}
    if len(files) < len(found):
        twice = next(path for path in found if path not in files.values())
        raise LabelError(f"{twice}: expected one mask of this name, got another with the suffix in other case")
    got = got_at(place) if place.exists() else "nothing of that name"
    if not files or (got != NONE and is_colour(next(iter(files.values())))):
        raise LabelError(
            f"{place}: expected ground truth: masks as .png, a folder with images/ and labels/ or masks/, COCO "
            f"annotations (.json) or sequences (.mcap), got {got}"
        )
    first = next(iter(files.values()))
    if is_colour(first):
        raise LabelError(
            f"{place}: expected ground truth, masks of one channel, got the colour image {first.name}: of images "
            "without labels nothing can be scored; `oysterbench segment` counts oysters in them"
        )
    listed = read_manifest(place)
    for name in files:
        if listed and name not in listed:
            raise LabelError(f"{place / FILE}: does not assign a clip to {name}")
    unscored, sides = scored_sides({name: row.split for name, row in listed.items()})
    for name in listed:
        if name not in files and name not in unscored:
            raise LabelError(f"{place / FILE}: lists {name!r}, but there is no {name}.png; every image needs its mask")
    groups: dict[str, list[str]] = {}
    for name in (name for name in files if name not in unscored):
        clip = listed[name].clip if listed else name.rpartition("/")[0] or place.resolve().name
        groups.setdefault(clip, []).append(name)

    def images(names: list[str]) -> Iterator[Seen]:
        for name in names:
            yield _plain_truth(name, files[name], labels, ignore_value), None

    return [
        LabelledSequence(
            clip,
            tuple(names),
            partial(images, names),
            _digest([files[name] for name in names]),
            sides=sides,
            unscored=unscored,
        )
        for clip, names in groups.items()
    ]


def _plain_truth(name: str, path: Path, labels: str, ignore_value: int | None) -> TruthImage:
    values = read_png(path)
    if labels == "classes" and ignore_value is None:
        ignore_value = IGNORED
    ignore = None if ignore_value is None else values == ignore_value
    if ignore is not None:
        values = np.where(ignore, 0, values)
        ignore = ignore if ignore.any() else None
    if labels != "classes":
        mask = as_mask(values, str(path), TRUTH_KINDS)
        return TruthImage(name, np.where(mask, np.uint8(OYSTER), np.uint8(0)), False, ignore)
    unknown = sorted(set(np.unique(values).tolist()) - set(CLASSES))
    if unknown:
        known = ", ".join(f"{number} {one}" for number, one in CLASSES.items())
        raise LabelError(f"{path}: unknown class {unknown[0]}; known classes: {known}; ignored: {ignore_value}")
    return TruthImage(name, values.astype(np.uint8), True, ignore)


def _digest(paths: list[Path]) -> str:
    text = hashlib.sha256()
    for path in paths:
        with open(path, "rb") as file:
            text.update(hashlib.file_digest(file, "sha256").digest())
    return text.hexdigest()
