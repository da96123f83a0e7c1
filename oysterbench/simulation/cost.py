"""Rendering cost of a sequence: estimated from its recipe beforehand, and measured while it is made."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterable
from pathlib import Path

from oysterbench.core.atomic import write_atomically
from oysterbench.recipe import CameraRecipe, SequenceRecipe, SplitRecipe, count
from oysterbench.simulation.jobs import wanted_sensors

COSTS = "costs.json"
"""File next to those of a split: sequence -> the processor time that it took here, s."""

_LOG = "cost.log"  # among the parts: a line with the processor time of each, so that it survives an interruption

PICTURE_PX = 640 * 480
FRAME_S = 0.30  # processor time for an image of PICTURE_PX of an empty bottom in daylight
OYSTERS_S = 0.30  # added by 100 oysters per m^2
PLANTS_S = 0.8  # added by a bottom that is all plants
LAMPS_S = 0.35  # added by lamps
SNOW_S = 0.1  # added by marine snow
SILT_S = 0.15  # added by plumes
LIFE_S = 0.15  # added by what moves by itself
EXPERT_S = 0.15  # for the values of an expert's commands, per labelled image of a steering split
PING_S = 0.1  # for each ping of a sonar that renders them one by one
FILE_BYTES = 0.35  # in a finished file, per pixel of its images, labels included
PART_BYTES = 0.9  # in the parts that are kept until it is finished
LINK_PART_BYTES = 2.3  # the same where a video link needs lossless images
BUILDING_S = 4e-4  # to build a reef, per oyster, in each process
"""Measured on one core of a 2.6 GHz server over the splits of this project, for which they hold to about a third."""

ASSEMBLED = 2
"""Sequences whose parts exist at the same time: one is assembled while the next is rendered."""


def estimated(
    split: SplitRecipe,
    sequence: SequenceRecipe,
    workers: int = 1,
    topics: Collection[str] = (),
    taken: Collection[str] = (),
) -> float:
    """Processor time, s, to render a sequence, or some topics of it, with a number of workers, each of which builds
    the reef. taken: topics that are not rendered."""
    rig = split.rig_of(sequence)
    reef = sequence.reef
    shaded = FRAME_S + OYSTERS_S * reef.oyster_count / reef.size_m**2 / 100.0 + PLANTS_S * reef.plant_cover
    if sequence.light.lamps > 0 and any(lamp.intensity_cd > 0 for lamp in rig.lamp):
        shaded += LAMPS_S
    shaded += SNOW_S * (sequence.water.snow_per_m3 > 0)
    shaded += SILT_S * (sequence.water.plumes.attenuation > 0) + LIFE_S * sequence.life.moves
    total = workers * BUILDING_S * reef.oyster_count
    if split.steering is not None:
        total += EXPERT_S * sum(count(sequence.duration_s, camera.rate_hz) for camera in rig.camera)
    for recipe in wanted_sensors(split, sequence, topics, taken).values():
        pictures = count(sequence.duration_s, recipe.rate_hz)
        if isinstance(recipe, CameraRecipe):
            total += pictures * shaded * recipe.width * recipe.height / PICTURE_PX
        else:
            total += pictures * PING_S
    return total


def space(split: SplitRecipe, sequences: Iterable[SequenceRecipe], topics: Collection[str] = ()) -> int:
    """Approximate peak of disk space, bytes, that rendering these sequences, or some topics of them, needs."""
    files, parts = 0.0, []
    for sequence in sequences:
        part = 0.0
        for recipe in wanted_sensors(split, sequence, topics).values():
            if isinstance(recipe, CameraRecipe):
                pixels = count(sequence.duration_s, recipe.rate_hz) * recipe.width * recipe.height
                files += FILE_BYTES * pixels
                part += (LINK_PART_BYTES if recipe.video_mbit_s else PART_BYTES) * pixels
        parts.append(part)
    return int(files + sum(sorted(parts)[-ASSEMBLED:]))


def measured(folder: Path) -> dict[str, float]:
    """Sequence -> processor time, s, of those rendered into a folder, as far as it is known."""
    try:
        found = json.loads((folder / COSTS).read_text())
        return {str(name): float(seconds) for name, seconds in found.items()}
    except (OSError, ValueError, AttributeError, TypeError):
        return {}


def add(parts: Path, cpu_s: float) -> None:
    """Record the processor time, s, of a part that has just been stored."""
    with open(parts / _LOG, "a") as file:
        file.write(f"{cpu_s:.4f}\n")


def keep(folder: Path, sequence: str, parts: Path) -> None:
    """Record the processor time of a sequence whose parts are all there."""
    try:
        lines = (parts / _LOG).read_text().splitlines()
    except OSError:  # parts of an older version
        return
    seconds = sum(float(line) for line in lines if re.fullmatch(r"\d+\.\d{4}", line))  # except one cut off by a kill
    costs = {**measured(folder), sequence: round(seconds, 1)}
    write_atomically(folder / COSTS, json.dumps(costs, indent=1).encode())
