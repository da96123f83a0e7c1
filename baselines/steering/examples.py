"""Training examples, read from sequences: views with the expert's value of each command."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError, MethodError, SequenceError
from oysterbench.methods.steering import VehicleState
from oysterbench.recipe import SplitRecipe, SteeringRecipe, load_split, parse_split, split_names
from oysterbench.sequence import open_sequence
from oysterbench.sequence.read import read_attachments
from oysterbench_baselines.steering.memory import Memory
from oysterbench_baselines.steering.network import SENSES, SteeringNetworkSettings

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class TrainingExamples:
    """N views of one task.

    pixels: (N, h, w, 3) uint8 RGB, at the network's size; senses: (N, SENSES) float32
    looked: (N, *memory.SHAPE) uint8, map of where the vehicle had looked by then
    action_values: (N, Y, P) float32, oysters gained by the expert's best plan that starts with a class of yaw and one
        of pitch
    from_rollout: (N,) bool, whether the view is from a rollout rather than from the trajectory of a sequence
    name: of the splits, for what is said of a training
    """

    task: SteeringRecipe
    pixels: NDArray[np.uint8]
    senses: Floats
    looked: NDArray[np.uint8]
    action_values: Floats
    from_rollout: NDArray[np.bool_]
    name: str = "examples"

    def __len__(self) -> int:
        return len(self.pixels)

    def __getitem__(self, n: int) -> tuple[NDArray[np.uint8], Floats, NDArray[np.uint8], Floats]:
        """Pixels, senses, looked and action_values of a view."""
        return self.pixels[n], self.senses[n], self.looked[n], self.action_values[n]

    def digest(self) -> str:
        """SHA-256 of all examples and the classes of the task."""
        found = hashlib.sha256(repr((self.task.yaw_deg, self.task.pitch_deg)).encode())
        for part in (self.pixels, self.senses, self.looked, self.action_values, self.from_rollout):
            found.update(str(part.shape).encode() + np.ascontiguousarray(part).tobytes())
        return found.hexdigest()


def joined(parts: Sequence[TrainingExamples]) -> TrainingExamples:
    """Concatenate examples in the given order. Raises MethodError where their classes differ."""
    task = parts[0].task
    for part in parts:
        check_classes(part.task, task.yaw_deg, task.pitch_deg, "the data")
    return TrainingExamples(
        task,
        np.concatenate([part.pixels for part in parts]),
        np.concatenate([part.senses for part in parts]),
        np.concatenate([part.looked for part in parts]),
        np.concatenate([part.action_values for part in parts]),
        np.concatenate([part.from_rollout for part in parts]),
        "+".join(dict.fromkeys(part.name for part in parts)),
    )


def check_classes(task: SteeringRecipe, yaw_deg: Sequence[float], pitch_deg: Sequence[float], where: str) -> None:
    """Raise MethodError where a task has other classes than these. where: for the message."""
    for axis, known in (("yaw", yaw_deg), ("pitch", pitch_deg)):
        asked = getattr(task, f"{axis}_deg")
        if tuple(asked) != tuple(known):
            raise MethodError(
                f"steering: {where}: expected the {len(known)} classes of {axis} {degrees(known)} deg, got "
                f"{len(asked)}: {degrees(asked)} deg; a network steers by the classes that it was trained with"
            )


def degrees(values: Sequence[float]) -> str:
    """Format angles in degrees as in a recipe."""
    return ", ".join(f"{value:g}" for value in values)


def small(pixels: NDArray[np.uint8], settings: SteeringNetworkSettings) -> NDArray[np.uint8]:
    """Reduce an image (H, W, 3) to the network's size, each pixel the mean of those that it covers."""
    size = (settings.width, settings.height)
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def senses_of(state: VehicleState, task: SteeringRecipe) -> Floats:
    """Senses (SENSES,) of the vehicle: altitude within the band to be kept, -1 at its lower edge and 1 at its upper
    one, and pitch as a fraction of the maximum. Heading and depth would only tell one reef from another."""
    low, high = task.altitude_m
    steepest = np.radians(task.max_pitch_deg) or 1.0
    found = (2 * (state.altitude - low) / (high - low) - 1, state.pitch / steepest)
    assert len(found) == SENSES
    return np.clip(np.array(found, dtype=np.float32), -3, 3)


def action_values_of(table: pd.DataFrame, task: SteeringRecipe, where: str) -> Floats:
    """Values (N, Y, P) of the commands in a table of labels. Raises LabelError where the table has other classes."""
    names = [f"value_{y}_{p}" for y in range(len(task.yaw_deg)) for p in range(len(task.pitch_deg))]
    found = {name for name in table.columns if name.startswith("value_")}
    if found != set(names):
        raise LabelError(
            f"{where}: expected a value for each of {len(task.yaw_deg)} x {len(task.pitch_deg)} commands, got "
            f"{len(found)} of them"
        )
    return table[names].to_numpy(np.float32).reshape(len(table), len(task.yaw_deg), len(task.pitch_deg))


def read_examples(path: Path, settings: SteeringNetworkSettings) -> TrainingExamples:
    """Read the labelled images of a sequence file. Raises LabelError where there are none."""
    sequence = open_sequence(path)
    table = sequence.steering()
    split = recipe_of(path)
    task = task_of(split, path)
    rows: dict[int, int] = {stamp: k for k, stamp in enumerate(table["stamp_ns"].to_numpy(np.int64).tolist())}
    states = table[["heading_rad", "pitch_rad", "depth_m", "altitude_m"]].to_numpy(np.float64)
    pixels, senses, looked, kept = [], [], [], []
    memory = Memory(task)
    for image in sequence.images(next(iter(sequence.cameras))):
        row = rows.get(image.stamp_ns)
        if row is None:
            continue
        pixels.append(small(image.pixels, settings))
        state = VehicleState(*states[row].tolist())
        senses.append(senses_of(state, task))
        looked.append(memory.observe(state, image.stamp_ns * 1e-9))
        kept.append(row)
    if not kept:
        raise LabelError(f"{path}: expected images with labels of steering, got none")
    action_values = action_values_of(table, task, str(path))
    return TrainingExamples(
        task,
        np.stack(pixels),
        np.stack(senses),
        np.stack(looked),
        action_values[kept],
        np.zeros(len(kept), dtype=bool),
        split.name,
    )


def recipe_of(path: Path) -> SplitRecipe:
    """Recipe of the split that a sequence file was made from. Raises SequenceError where the file does not hold it."""
    held = read_attachments(path)
    try:
        return parse_split(held["split.toml"].decode(), f"{path}: split.toml", rig_source=held["rig.toml"].decode())
    except KeyError as error:
        raise SequenceError(f"{path} has no ground truth about steering: no attachment {error}") from None


def task_of(split: SplitRecipe, path: Path) -> SteeringRecipe:
    """Steering task of the split of a sequence file. Raises LabelError where it is not of the track steering."""
    if split.steering is None:
        raise LabelError(
            f"{path}: expected a sequence of a split of the track steering; `oysterbench splits` lists them"
        )
    return split.steering


def files_of(name: str) -> list[Path]:
    """Sequence files of a split, which is rendered if missing, of a folder, or the one at a path. Raises LabelError
    where there are none, or the split is of another track."""
    if name in split_names() or name.endswith(".toml"):
        from oysterbench.cli.render import render_files

        split = load_split(name)
        if split.steering is None:
            raise LabelError(f"{name}: expected a split of the track steering, got one of {split.track}")
        return list(render_files(split).values())
    path = Path(name)
    found = sorted(path.glob("*.mcap")) if path.is_dir() else [path] if path.is_file() else []
    if not found:
        raise LabelError(
            f"{name}: expected a split, a sequence (.mcap) or a folder of them; `oysterbench splits` lists splits"
        )
    return found


def read_all(
    paths: Iterable[Path],
    settings: SteeringNetworkSettings,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> TrainingExamples:
    """Read the labelled images of several files, in their order."""
    paths = list(paths)
    parts = []
    for done, path in enumerate(paths, start=1):
        parts.append(read_examples(path, settings))
        progress(done, len(paths))
    return joined(parts)
