"""Fan images and other pings per second of processor time: `python tests/benchmarks/sonar.py`.

The reef of slam-mini (3000 oysters), with an imaging sonar of 256 beams x 500 bins, 130 x 20 deg, along the path.
"""

from __future__ import annotations

import argparse
import dataclasses
import resource
import time

import numpy as np

from oysterbench.recipe import SiteRecipe, load_split
from oysterbench.sensors.altimeter import AltimeterRecipe
from oysterbench.sensors.dvl import DvlRecipe
from oysterbench.sensors.scanner import ScannerRecipe
from oysterbench.sensors.sonar import SonarRecipe

SITE = SiteRecipe()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pings", type=int, default=40)
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()

    from oysterbench.core.geometry import transform
    from oysterbench.core.streams import Streams
    from oysterbench.render.rays import RayCaster
    from oysterbench.scene.path import build_path
    from oysterbench.scene.world import build_world
    from oysterbench.sensors import altimeter, dvl
    from oysterbench.sensors.scanner import ScanningSonar
    from oysterbench.sensors.sonar import ImagingSonar

    split = load_split("slam-mini")
    recipe = split.sequence[0]
    streams = Streams(split.seed, b"", (recipe.name,))
    world = build_world(recipe, streams)
    path = build_path(recipe, world.ground_height, world.obstacle_height, streams)
    caster = RayCaster(world, options.device)
    fan = SonarRecipe(name="fan", rate_hz=10.0, pitch_deg=20.0)
    fans = {
        "fan image": fan,
        "with multipath and cloud": dataclasses.replace(fan, multipath=0.3, cloud=True),
        "4 looks": dataclasses.replace(fan, looks=4.0),
    }
    sonars: dict[str, ImagingSonar | ScanningSonar] = {
        name: ImagingSonar(caster, each, SITE, recipe.reef.bottom) for name, each in fans.items()
    }
    sonars["scanner ping"] = ScanningSonar(caster, ScannerRecipe(name="scan", rate_hz=10.0), SITE, recipe.reef.bottom)
    motion = path.at(np.linspace(0.0, recipe.duration_s, options.pings))
    poses = [transform(turn, place) for turn, place in zip(motion.rotation, motion.position, strict=True)]
    print(f"{len(world.oysters)} oysters, {options.pings} pings each, {options.device}")
    print(f"{'':26}{'CPU ms':>9}{'per CPU-second':>16}{'wall ms':>9}")
    for name, sonar in sonars.items():
        sonar.ping(poses[0], streams, 0)
        wall, busy = time.perf_counter(), time.process_time()
        for index, pose in enumerate(poses):
            sonar.ping(pose, streams, index)
        report(name, time.process_time() - busy, time.perf_counter() - wall, options.pings)

    times = np.linspace(0.0, recipe.duration_s, 400)
    wall, busy = time.perf_counter(), time.process_time()
    dvl.measure(path, caster, DvlRecipe(), SITE, times, np.arange(400), streams)
    report("dvl", time.process_time() - busy, time.perf_counter() - wall, 400)
    wall, busy = time.perf_counter(), time.process_time()
    altimeter.measure(path, caster, AltimeterRecipe(name="altimeter", rate_hz=10.0), SITE, times, streams)
    report("altimeter", time.process_time() - busy, time.perf_counter() - wall, 400)
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


def report(name: str, busy: float, wall: float, count: int) -> None:
    """One row."""
    print(f"{name:26}{1e3 * busy / count:9.2f}{count / busy:16.1f}{1e3 * wall / count:9.2f}")


if __name__ == "__main__":
    main()
