"""Labelled images: what the front camera saw, the state of the vehicle, and the expert's command there."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from oysterbench.core.errors import LabelError, SequenceError
from oysterbench.evaluate.steering import Labels
from oysterbench.methods.steering import VehicleState, View
from oysterbench.recipe import SteeringRecipe
from oysterbench.sequence import Sequence, open_sequence

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("stamp_ns", "yaw", "pitch", "heading_rad", "pitch_rad", "depth_m", "altitude_m")


@dataclass(frozen=True)
class LabelledViews:
    """A sequence with steering labels. table: from `Sequence.steering`, a row for each image of `camera`, in order."""

    sequence: Sequence
    camera: str
    table: pd.DataFrame
    task: SteeringRecipe

    @property
    def name(self) -> str:
        """Name of the sequence."""
        return self.sequence.name

    def views(self) -> Iterator[View]:
        """Iterate over the views in time order. Raises LabelError where labels and images do not match."""
        stamps = self.table["stamp_ns"].to_numpy()
        states = self.table[list(COLUMNS[3:])].to_numpy(dtype=float)
        times = (stamps - stamps[:1]) * 1e-9
        k = 0
        for k, image in enumerate(self.sequence.images(self.camera)):
            if k >= len(stamps) or image.stamp_ns != stamps[k]:
                raise LabelError(
                    f"{self.name}: image {k + 1} of {self.camera}, stamp {image.stamp_ns}: expected a label of that "
                    f"stamp, got {stamps[k] if k < len(stamps) else 'none'}"
                )
            yield View(self.name_of(k), image.pixels, VehicleState(*states[k].tolist()), float(times[k]))
        if k + 1 < len(stamps):
            raise LabelError(f"{self.name}: {len(stamps)} labels, and only {k + 1} images of {self.camera}")

    def name_of(self, k: int) -> str:
        """Name of view k."""
        return f"{self.name}/{self.camera}/{self.table['stamp_ns'].iloc[k]}"

    @cached_property
    def labels(self) -> Labels:
        """Labels of all images."""
        y, p = len(self.task.yaw_deg), len(self.task.pitch_deg)
        keys = [f"value_{i}_{j}" for i in range(y) for j in range(p)]
        values = self.table[keys].to_numpy(dtype=float).reshape(-1, y, p)
        return Labels(self.table[["yaw", "pitch"]].to_numpy(dtype=np.int64), values, self.task, self.name)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of stamps, classes and action values."""
        found = hashlib.sha256(self.table["stamp_ns"].to_numpy(dtype="<i8").tobytes())
        found.update(self.labels.classes.astype("<i8").tobytes())
        found.update(self.labels.action_values.astype("<f8").tobytes())
        return found.hexdigest()


def labelled_views(path: Path, task: SteeringRecipe) -> LabelledViews:
    """Open the labelled images of a sequence file.

    Raises LabelError where it has no labels, labels of another task, or no camera.
    """
    sequence = open_sequence(path)
    try:
        table = sequence.steering()
    except SequenceError as error:
        raise LabelError(
            f"{error}; expected a sequence of a split of the track steering, such as steer-mini, rendered by this "
            "version of oysterbench"
        ) from None
    wanted = [*COLUMNS, *(f"value_{i}_{j}" for i in range(len(task.yaw_deg)) for j in range(len(task.pitch_deg)))]
    found = [key for key in table.columns if key.startswith("value_")]
    if missing := [key for key in wanted if key not in table.columns]:
        raise LabelError(f"{path}: the labels lack the column {missing[0]!r}")
    if len(found) != len(wanted) - len(COLUMNS):
        raise LabelError(
            f"{path}: expected values of {len(task.yaw_deg)} x {len(task.pitch_deg)} commands, got {len(found)}"
        )
    if not sequence.cameras:
        raise LabelError(f"{path}: no camera whose images could be labelled")
    return LabelledViews(sequence, next(iter(sequence.cameras)), table, task)
