"""Assembly of a sequence from its parts, in time order; a video link codes frame after frame."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from oysterbench.core.atomic import naming
from oysterbench.core.errors import OysterbenchError
from oysterbench.core.geometry import Array
from oysterbench.core.ros import EPOCH_NS, TF_STATIC, Message
from oysterbench.recipe import CLASSES, REEF_CLASSES, RigRecipe, SequenceRecipe, SplitRecipe
from oysterbench.sensors.registry import calibrate_rig, kind_of, rig_frames
from oysterbench.sequence.cut import read_written
from oysterbench.sequence.file import read_attachments, read_messages
from oysterbench.sequence.read import CALIBRATION, METADATA, TRUE_CALIBRATION
from oysterbench.sequence.truth import static_transforms
from oysterbench.sequence.write import SequenceWriter
from oysterbench.simulation.jobs import Job, bulky_sensors, plan, sources, wanted_topics
from oysterbench.version import GENERATION


def assemble(
    split: SplitRecipe,
    recipe: SequenceRecipe,
    parts: Path,
    path: Path,
    made_by: str,
    salt: bytes = b"",
    topics: Collection[str] = (),
    taken: Mapping[str, Path] | None = None,
    stop: threading.Event | None = None,
) -> None:
    """Assemble the parts of a sequence in time order; the file appears in one step, or not at all where another thread
    sets `stop`. With patterns of topics, it is the file that `sequence.cut` would make of the complete one. taken:
    topic -> file of the same sequence that its messages are copied from, the same as the parts would give."""
    recipe = split.drawn(recipe, salt)
    rig = split.rig_of(recipe)
    calibration = calibrate_rig(rig, recipe.site, recipe.calibration, split.streams_of(recipe, salt))
    taken = taken or {}
    jobs = plan(split, recipe, topics, taken)
    wanted = wanted_topics(split, recipe, topics)
    temporary = parts / "whole.mcap"  # next to the parts, so that what a kill leaves goes with them
    with naming(path, parts), open(temporary, "wb") as file:
        writer = SequenceWriter(file, wanted)
        writer.metadata(
            METADATA,
            {
                "sequence": recipe.name,
                "split": split.name,
                "split_version": split.version,
                "track": split.track,
                "rig": rig.name,
                "digest": made_by,
                "generation": str(GENERATION),
            },
        )
        writer.attachment(CALIBRATION, "application/json", json.dumps(calibration.given, indent=1).encode())
        classes = CLASSES if recipe.life.moves else REEF_CLASSES
        writer.attachment("classes.json", "application/json", json.dumps(classes).encode())
        for name, text in split.texts.items():
            writer.attachment(name, "application/toml", text)
        for name, table in read_attachments(parts / Job(recipe.name).part).items():
            writer.attachment(name, "text/csv", table)
        if calibration.true != calibration.given:
            truth = {**calibration.true, "errors": calibration.errors}
            writer.attachment(TRUE_CALIBRATION, "application/json", json.dumps(truth, indent=1).encode())
        if TF_STATIC in wanted:
            writer.write(static_transforms(EPOCH_NS, _frames(rig, calibration.given)))
            writer.section()
        bulky = bulky_sensors(rig)
        for topic, source in sources(rig).items():  # one section per topic, so that reading one touches no other
            if topic not in wanted:
                continue
            files = [parts / job.part for job in jobs if job.source == source]
            messages = _read_parts(files, topic) if topic not in taken else read_written(taken[topic], [topic])
            if source and topic not in taken:
                messages = kind_of(bulky[source]).pass_on(bulky[source], topic, messages)
            for message in messages:
                if stop is not None and stop.is_set():
                    raise OysterbenchError(f"{path}: stopped while it was being assembled; its parts are kept")
                writer.write(message)
            writer.section()
        writer.finish()
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def _read_parts(files: list[Path], topic: str) -> Iterator[Message]:
    for file in files:
        yield from read_messages(file, [topic])


def _frames(rig: RigRecipe, calibration: Mapping[str, Any]) -> dict[str, tuple[Array, Array]]:
    """Poses in base_link of the rig's frames: name -> (position (3,) m, quaternion (4,))."""
    from scipy.spatial.transform import Rotation

    frames = {}
    for frame, (kind, name) in rig_frames(rig).items():
        entry = calibration[kind.key] if kind.single else calibration[kind.key][name]
        T = np.array(entry[kind.pose])
        frames[frame] = (T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True))
    return frames
