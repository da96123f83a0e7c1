"""Structure from motion of the pictures of one camera, by pycolmap; a program of its own, without this project.

    python reconstruct.py TASK.json FOLDER OUT.tum

The poses, T_world_camera up to scale, are those of the largest of the models that it finds.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import pycolmap

MAX_COEFFICIENT = math.inf
"""It discards cameras with distortion coefficients above 1 as bogus, as those of a flat port under water are."""


def main(task_file: str, folder: str, out: str) -> None:
    """Reconstruct, and write the path."""
    task: dict[str, Any] = json.loads(Path(task_file).read_text(encoding="utf-8"))
    pictures = Path(folder) / "mav0" / "cam0" / "data"
    rows = (Path(folder) / "mav0" / "cam0" / "data.csv").read_text(encoding="utf-8").splitlines()
    fields = [row.split(",") for row in rows if row and not row.startswith("#")]
    step = max(1, round(task["frame_rate_hz"] / task["rate_hz"]))
    pycolmap.set_random_seed(task["seed"])
    with tempfile.TemporaryDirectory() as scratch:
        stamps, chosen = {}, Path(scratch) / "pictures"
        chosen.mkdir()
        for number, (stamp, picture, *_) in enumerate(fields[::step]):
            # The order of names says which are neighbours: a stamp of 9 digits would come after those of 10.
            name = f"{number:06d}{Path(picture.strip()).suffix}"
            (chosen / name).symlink_to((pictures / picture.strip()).absolute())
            stamps[name] = int(stamp) + task["shift_ns"]
        database = Path(scratch) / "database.db"
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.sift.max_num_features = task["max_num_features"]
        extraction.sift.peak_threshold = task["peak_threshold"]
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = task["camera_model"]
        reader.camera_params = ",".join(map(repr, task["camera_params"]))
        single = pycolmap.CameraMode.SINGLE
        pycolmap.extract_features(database, chosen, list(stamps), single, reader, extraction)
        pairing = pycolmap.SequentialPairingOptions()
        pairing.overlap = task["overlap"]
        pycolmap.match_sequential(database, pairing_options=pairing)
        models = MAPPERS[task["mapper"]](task, database, chosen, scratch)
    if not models:
        sys.exit("COLMAP found no pair of pictures to begin with")
    largest = max(models.values(), key=lambda model: model.num_reg_images())
    sizes = ", ".join(str(model.num_reg_images()) for model in models.values())
    print(f"{len(models)} models of {sizes} of {len(stamps)} pictures")
    poses = {}
    for image in largest.images.values():
        if image.has_pose:
            placed = image.cam_from_world().inverse()
            poses[stamps[image.name]] = (*placed.translation, *placed.rotation.quat)  # x y z w
    with open(out, "w", encoding="utf-8") as file:
        for stamp, pose in sorted(poses.items()):
            file.write(f"{stamp // 10**9}.{stamp % 10**9:09d} {' '.join(f'{value:.9g}' for value in pose)}\n")


def incremental(task: dict[str, Any], database: Path, pictures: Path, scratch: str) -> dict[int, Any]:
    """Models, each grown from a pair of pictures by one picture after another (Schönberger & Frahm 2016)."""
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = task["seed"]
    options.ba_refine_focal_length = False  # the camera is calibrated
    options.ba_refine_extra_params = False
    options.max_extra_param = MAX_COEFFICIENT
    options.mapper.abs_pose_refine_focal_length = False
    options.mapper.abs_pose_refine_extra_params = False
    options.mapper.init_min_tri_angle = task["init_min_tri_angle"]  # degrees
    models: dict[int, Any] = pycolmap.incremental_mapping(database, pictures, scratch, options)
    return models


def at_once(task: dict[str, Any], database: Path, pictures: Path, scratch: str) -> dict[int, Any]:
    """Models of all pictures together: averaged rotations, then positions and points (Pan et al. 2024)."""
    options = pycolmap.GlobalPipelineOptions()
    options.random_seed = task["seed"]
    options.mapper.random_seed = task["seed"]
    options.mapper.bundle_adjustment.refine_focal_length = False  # the camera is calibrated
    options.mapper.bundle_adjustment.refine_extra_params = False
    options.mapper.retriangulation.max_extra_param = MAX_COEFFICIENT
    models: dict[int, Any] = pycolmap.global_mapping(database, pictures, scratch, options)
    return models


MAPPERS = {"incremental": incremental, "global": at_once}


if __name__ == "__main__":
    main(*sys.argv[1:])
