"""True positions in other images of the points of one image of a sequence: labels that rendering gives for free."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError
from oysterbench.core.geometry import Array, invert
from oysterbench.core.trajectory import Trajectory
from oysterbench.recipe import LIFE_CLASSES, REEF_CLASSES, load_split, split_names
from oysterbench.sequence import open_sequence
from oysterbench_baselines.gtsam_vi_learned.lens import TrueLens

AT_REST = frozenset({"bottom", "oyster", "stone", "sponge"})
"""Classes whose points stay where they are: plants sway, animals swim, and the vehicle moves along."""
SHUTTER_ITERATIONS = 3  # of the row in which a point is read out: 30 px between two rows at 0.1 px each
EDGE = 0.01  # of the inverse depth, by which its surroundings differ: beyond, a pixel lies on an occluding edge


@dataclass(frozen=True)
class Anchor:
    """An image with known depth: its number among the images; depth (H, W) float32 m, 0 where no point at rest is seen,
    or one on an edge."""

    picture: int
    depth: NDArray[np.float32]


class Footage:
    """The images of one camera of a rendered sequence, the true motion of the camera, and depths for some of them.

    pictures: (H, W) uint8 grey, in time order; repeated ones are left out. taken_ns: (P,) int64, when each was taken.
    """

    def __init__(self, path: Path, camera: str | None = None) -> None:
        sequence = open_sequence(path)
        self.name, self.digest = sequence.name, hashlib.sha256(path.read_bytes()).hexdigest()
        camera = camera or next(iter(sequence.cameras))
        if f"/{camera}/depth" not in {topic for topic, _, _ in sequence.contents()}:
            raise LabelError(f"{path}: expected a rendered sequence with the layers depth and class of {camera}")
        true = sequence.truly_calibrated()
        self.lens = TrueLens(true.cameras[camera])
        self._path = true.truth()
        self.pictures: list[NDArray[np.uint8]] = []
        self.anchors: list[Anchor] = []
        taken: list[int] = []
        depths = {item.stamp_ns: item.pixels for item in sequence.layer(camera, "depth")}
        classes = {item.stamp_ns: item.pixels for item in sequence.layer(camera, "class")}
        for image in sequence.images(camera):
            taken_ns = true.cameras[camera].taken_ns(image.stamp_ns)
            if taken_ns in taken[-1:]:  # it repeats the image before
                continue
            if image.stamp_ns in depths:
                self.anchors.append(Anchor(len(taken), _at_rest(depths[image.stamp_ns], classes[image.stamp_ns])))
            self.pictures.append(np.asarray(cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY), dtype=np.uint8))
            taken.append(taken_ns)
        self.taken_ns = np.array(taken, dtype=np.int64)

    def pairs(self, most_s: float) -> list[tuple[int, int]]:
        """All pairs (anchor number, image number) at most `most_s` apart in time, except for the anchor's own image."""
        found = []
        for k, anchor in enumerate(self.anchors):
            apart = np.abs(self.taken_ns - self.taken_ns[anchor.picture])
            found += [(k, int(j)) for j in np.flatnonzero((apart <= most_s * 1e9) & (apart > 0))]
        return found

    def warp(self, anchor: Anchor, picture: int, pixels: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Positions in another image of points at integer pixels (N, 2) of an anchor: pixels (N, 2), and for which (N,)
        they are known. Occlusions in the other image are ignored."""
        x, y = pixels.astype(int).T
        depth = anchor.depth[y, x].astype(float)
        known = depth > 0
        places = self.lens.points(pixels.astype(float), np.where(known, depth, 1.0))
        there, first = self._poses(self.taken_ns[anchor.picture], pixels[:, 1])
        middle = (self.lens.calibration.height - 1) / 2
        end = np.column_stack([pixels[:, 0], np.full(len(pixels), middle)]).astype(float)
        world = np.einsum("nij,nj->ni", there[:, :3, :3], places) + there[:, :3, 3]
        inside = known & first
        for _ in range(SHUTTER_ITERATIONS):
            poses, within = self._poses(self.taken_ns[picture], np.clip(end[:, 1], 0, 2 * middle))
            back = invert(poses)
            seen = np.einsum("nij,nj->ni", back[:, :3, :3], world) + back[:, :3, 3]
            end = self.lens.pixels(seen)
            if not self.lens.calibration.readout_s:
                break
        inside &= within & (seen[:, 2] > 0.05)
        inside &= (end >= 0).all(axis=1) & (end <= [self.lens.calibration.width - 1, 2 * middle]).all(axis=1)
        return end, inside

    def _poses(self, taken_ns: np.int64, rows: Array) -> tuple[Array, NDArray[np.bool_]]:
        """T_map_cam (N, 4, 4) when rows (N,) were read out, and for which (N,) the path extends that far."""
        calibration = self.lens.calibration
        late = (rows / (calibration.height - 1) - 0.5) * calibration.readout_s
        wanted = taken_ns + np.round(late * 1e9).astype(np.int64)
        begin, end = self._path.stamps_ns[0], self._path.stamps_ns[-1]
        path: Trajectory = self._path.at(np.clip(wanted, begin, end))
        return path.matrices @ calibration.T_base_cam, (wanted >= begin) & (wanted <= end)


def _at_rest(depth: NDArray[np.float32], classes: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Depths (H, W) m of points at rest, away from edges; 0 elsewhere."""
    numbers = [number for number, name in {**REEF_CLASSES, **LIFE_CLASSES}.items() if name in AT_REST]
    inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-3), 0.0).astype(np.float32)
    # The inverse depth of a plane is linear over the image, and its mean about a pixel is the pixel's own.
    good = np.isin(classes, numbers) & (depth > 0) & (np.abs(cv2.blur(inverse, (3, 3)) - inverse) < EDGE * inverse)
    return np.where(good, depth, 0.0).astype(np.float32)


def files_of(name: str, wanted: Iterable[str] = ()) -> list[Path]:
    """Sequence files of a split, which is rendered if missing, of a folder, or the one at a path. wanted: only
    sequences of these names, if any are given. Raises LabelError where there are none."""
    wanted = tuple(wanted)
    if name in split_names() or name.endswith(".toml"):
        from oysterbench.cli.render import render_files

        files = render_files(load_split(name), names=wanted)
        return [file for sequence, file in files.items() if not wanted or sequence in wanted]
    path = Path(name)
    found = sorted(path.glob("*.mcap")) if path.is_dir() else [path] if path.is_file() else []
    found = [file for file in found if not wanted or file.stem in wanted]
    if not found:
        raise LabelError(
            f"{name}: expected a split, a sequence (.mcap) or a folder of them; `oysterbench splits` lists splits"
        )
    return found


def read_footage(
    paths: Iterable[Path], progress: Callable[[int, int], None] = lambda done, total: None
) -> list[Footage]:
    """Read the footage of several files, in their order."""
    paths, found = list(paths), []
    for done, path in enumerate(paths, start=1):
        found.append(Footage(path))
        progress(done, len(paths))
    return found
