"""How long a frame takes, stage by stage, in seconds of processor time: `python tests/benchmarks/render_stages.py`.

A reef of 20 000 oysters, 640 x 480, with every effect on: snow, caustics, lamps, hidden sky, blur, a distorting lens.
"""

from __future__ import annotations

import argparse
import dataclasses
import resource
import sys
import time

import cv2
import numpy as np

from oysterbench.core.geometry import transform
from oysterbench.recipe import LampRecipe, SplitRecipe, load_split, vary_split

EVERYTHING = {
    "water.snow_per_m3": 3000.0,
    "water.forward_blur": 1.0,
    "light.wind_m_s": 4.0,
    "light.occlusion_m": 0.2,
    "camera.lens": "brown-conrady",
    "camera.distortion": [0.12, 0.06, 0.0, 0.0],
    "camera.vignetting": 0.6,
}
BIG_REEF = {"reef.size_m": 30.0, "reef.oysters": 20_000, "path.radius_m": 6.0}


def scene(effects: bool, big: bool) -> SplitRecipe:
    """slam-mini, with every effect on, over a big reef, or both."""
    changes = {**(EVERYTHING if effects else {}), **(BIG_REEF if big else {})}
    split = vary_split(load_split("slam-mini"), changes, "benchmark")
    lamps = tuple(LampRecipe(intensity_cd=400.0, position_m=(0.24, y, -0.1), pitch_deg=25.0) for y in (-0.12, 0.12))
    return dataclasses.replace(split, rig=dataclasses.replace(split.rig, lamp=lamps if effects else ()))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--plain", action="store_true", help="slam-mini as it is")
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()

    began = time.perf_counter()
    from oysterbench.core.streams import Streams
    from oysterbench.render.camera import CameraRenderer, warm_up
    from oysterbench.scene.path import build_path
    from oysterbench.scene.rig import camera_pose
    from oysterbench.scene.world import build_world

    warm_up(options.device)
    loaded = time.perf_counter()
    split = scene(not options.plain, not options.plain)
    recipe, camera = split.sequence[0], split.rig.camera[0]
    streams = Streams(split.seed, b"", (recipe.name,))
    world = build_world(recipe, streams)
    path = build_path(recipe, world.ground_height, world.obstacle_height, streams)
    renderer = CameraRenderer(world, camera, recipe, device=options.device, rig=split.rig)
    built = time.perf_counter()
    times = np.linspace(2.0, recipe.duration_s - 1.0, options.frames)
    motion = path.at(times)
    colours = []
    wall = time.perf_counter()
    start = time.process_time()
    for time_s, rotation, position in zip(times, motion.rotation, motion.position, strict=True):
        body = transform(rotation, position)
        frame = renderer.render(body @ camera_pose(camera), streams.generator("noise"), float(time_s), body)
        colours.append(frame.colour)
        begun = time.process_time()
        cv2.imencode(".jpg", frame.colour, [cv2.IMWRITE_JPEG_QUALITY, camera.jpeg_quality])
        renderer.seconds["encode"] += time.process_time() - begun
    total = (time.process_time() - start) / options.frames
    wall = (time.perf_counter() - wall) / options.frames

    print(f"load {loaded - began:.1f} s, build {built - loaded:.1f} s, {len(world.oysters)} oysters")
    for name, seconds in renderer.seconds.items():
        print(f"{name:16s} {seconds / options.frames:8.4f}")
    print(f"{'whole frame':16s} {total:8.4f}   ({1 / wall:.1f} frames/s by the clock)")
    per_mib = 1024 if sys.platform != "darwin" else 1024**2
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / per_mib:.0f} MiB")


if __name__ == "__main__":
    main()
