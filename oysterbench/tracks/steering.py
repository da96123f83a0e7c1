"""The track steering over labelled pictures: methods run, scored against the expert, and recorded."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array
from oysterbench.evaluate.steering import EVALUATOR, Commands, score_pictures
from oysterbench.evaluate.steering.labels import one_hot
from oysterbench.evaluate.steering.pictures import AXES
from oysterbench.exploration.labelled_views import LabelledViews
from oysterbench.methods.piloting import commands
from oysterbench.methods.steering import Steering, View
from oysterbench.recipe import SplitRecipe, SteeringRecipe
from oysterbench.report.steering import PictureRun
from oysterbench.results.records import ResultRecord
from oysterbench.simulation.conditions import conditions
from oysterbench.simulation.generate import digest

TRACK = "steering"
Announce = Callable[[str], None]


def evaluate_pictures(
    split: SplitRecipe,
    dives: Sequence[LabelledViews],
    methods: Sequence[Any],
    announce: Announce = lambda text: None,
) -> list[PictureRun]:
    """Run each method over the labelled pictures of each sequence; one that fails leaves a record with `failure`."""
    runs = []
    for dive in dives:
        for method in methods:
            announce(f"running {method.name} on {dive.name}")
            runs.append(_run(split, dive, method))
    return runs


def _run(split: SplitRecipe, dive: LabelledViews, method: Any) -> PictureRun:
    about: dict[str, Any] = {
        "track": TRACK,
        "split": split.name,
        "split_digest": digest(split),
        "sequence": dive.name,
        "truth_digest": dive.digest,
        "conditions": conditions(split, dive.name),
        "evaluator_version": EVALUATOR,
        "method": method.name,
        "seed": getattr(method, "seed", None),
        "method_settings": getattr(method, "as_dict", dict)(),
    }
    clock = Clock()
    try:
        answered = answers(method, dive, clock)
    except MethodError as error:
        return PictureRun(ResultRecord(**about, failure=str(error)))
    score = score_pictures(dive.labels, answered)
    metrics = {**score.metrics, **clock.metrics(len(answered.classes))}
    return PictureRun(ResultRecord(**about, metrics=metrics, reasons=score.reasons), dive.labels, answered, score)


class Clock:
    """What a method takes, without the reading of pictures."""

    def __init__(self) -> None:
        self.wall_s = self.cpu_s = 0.0

    def leave_out(self, views: Iterable[View]) -> Iterator[View]:
        """The views; what their reading takes is not the method's."""
        before = self._now()
        for view in views:
            self._add(before, -1)
            yield view
            before = self._now()
        self._add(before, -1)

    def metrics(self, pictures: int) -> dict[str, float]:
        """For the record."""
        found = {"wall_s": self.wall_s, "cpu_s": self.cpu_s}
        return {**found, "pictures_per_s": pictures / self.wall_s} if self.wall_s > 0 else found

    def _now(self) -> tuple[float, float]:
        return time.perf_counter(), time.process_time()

    def _add(self, before: tuple[float, float], sign: int) -> None:
        now = self._now()
        self.wall_s += sign * (now[0] - before[0])
        self.cpu_s += sign * (now[1] - before[1])

    def __enter__(self) -> None:
        self._began = self._now()

    def __exit__(self, *_: object) -> None:
        self._add(self._began, 1)


def answers(method: Any, dive: LabelledViews, clock: Clock | None = None) -> Commands:
    """The commands of a method at each labelled picture, which it is given one by one, in time order.

    Raises MethodError, naming it, where it fails, reads ahead, answers another view, or leaves one out.
    """
    clock = clock or Clock()
    classes: list[tuple[int, int]] = []
    shares: tuple[list[Array], list[Array]] = ([], [])
    with clock:
        for _, answer, chosen in commands(method, dive.task, clock.leave_out(dive.views()), dive.name):
            classes.append(chosen)
            for kept, one in zip(shares, probabilities(answer, chosen, dive.task), strict=True):
                kept.append(one)
    if len(classes) < len(dive.table):
        raise MethodError(
            f"method {method.name!r} on {dive.name}: expected {len(dive.table)} answers, one to each view, got "
            f"{len(classes)}"
        )
    yaw, pitch = (np.array(of).reshape(len(classes), -1) for of in shares)
    return Commands(np.array(classes, dtype=np.int64).reshape(-1, 2), yaw, pitch)


def probabilities(answer: Steering, classes: tuple[int, int], task: SteeringRecipe) -> tuple[Array, Array]:
    """Of each class of yaw (Y,) and of pitch (P,), adding up to 1; an answer that was checked."""
    found = []
    for axis, chosen, degrees in zip(AXES, classes, (task.yaw_deg, task.pitch_deg), strict=True):
        given = getattr(answer, f"{axis}_probability")
        if given is None:
            found.append(one_hot(np.array([chosen]), len(degrees))[0])
        else:
            scaled = np.asarray(given, dtype=float) / np.max(given)  # a sum of the largest numbers has no end
            found.append(scaled / scaled.sum())
    return found[0], found[1]
