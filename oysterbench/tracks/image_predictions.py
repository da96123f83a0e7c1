"""A method at work on a clip: pictures in, answers out, one at a time, and what it costs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations import LabelledSequence
from oysterbench.core.errors import LabelError, MethodError, OysterbenchError
from oysterbench.evaluate.detection import ImageInstances
from oysterbench.evaluate.detection.instances import Instance, from_mask, from_planes
from oysterbench.evaluate.segmentation import EstimateImage, TruthImage
from oysterbench.methods.images import Detections, Picture, Segmentation


@dataclass
class Cost:
    """What a method took, without the reading of pictures and the scoring."""

    wall_s: float = 0.0
    cpu_s: float = 0.0
    images: int = 0
    _since: tuple[float, float] = field(default=(0.0, 0.0), repr=False)

    def begin(self) -> None:
        """From here on the method is at work."""
        self._since = (time.perf_counter(), time.process_time())

    def end(self) -> None:
        """It is no more."""
        self.wall_s += time.perf_counter() - self._since[0]
        self.cpu_s += time.process_time() - self._since[1]

    @property
    def metrics(self) -> dict[str, float]:
        """For the record."""
        if not self.images or self.wall_s <= 0:
            return {}
        return {"wall_s": self.wall_s, "cpu_s": self.cpu_s, "images_per_s": self.images / self.wall_s}


Answered = tuple[TruthImage, NDArray[np.uint8], Any]
"""A truth, its picture, and the answer to it."""


def answers_of(method: Any, clip: LabelledSequence, cost: Cost) -> Iterator[Answered]:
    """The answers of a method to the pictures of a clip, in their order, each with its truth, which it never sees.

    Raises MethodError where it fails, or does not answer picture by picture.
    """
    waiting: dict[str, tuple[TruthImage, NDArray[np.uint8]]] = {}

    def pictures() -> Iterator[Picture]:
        cost.end()
        for truth, pixels in clip.images():
            if pixels is None:
                raise LabelError(f"{truth.name}: expected a picture to run {method.name} on, got the truth alone")
            waiting[truth.name] = (truth, pixels)
            cost.begin()
            yield Picture(truth.name, pixels.copy())
            cost.end()
        cost.begin()

    cost.begin()
    try:
        answers = iter(method.run(pictures()))
        while True:
            answer = next(answers, None)
            cost.end()
            if answer is None:
                break
            expected = next(iter(waiting), None)
            if expected is None or getattr(answer, "name", None) != expected:
                raise MethodError(
                    f"method {method.name!r} on {clip.name}: expected an answer to {expected or 'nothing more'}, "
                    f"got one to {getattr(answer, 'name', answer)!r:.80}"
                )
            cost.images += 1
            yield (*waiting.pop(expected), answer)
            cost.begin()
    except OysterbenchError:
        raise
    except Exception as error:
        line = " ".join(f"{type(error).__name__}: {error}".split())
        raise MethodError(f"method {method.name!r} failed on {clip.name}: {line}") from error
    if cost.images < len(clip.names):
        raise MethodError(
            f"method {method.name!r} on {clip.name}: expected {len(clip.names)} answers, one to each picture, got "
            f"{cost.images}"
        )


def segmentation_of(answer: Any, method: str) -> EstimateImage:
    """The answer of a method of the track segmentation, checked."""
    if not isinstance(answer, Segmentation):
        raise MethodError(f"method {method!r}: expected answers of the kind Segmentation, got {type(answer).__name__}")
    return EstimateImage(answer.name, answer.oyster, answer.probability, answer.classes)


def instances_of(answer: Any, method: str, shape: tuple[int, int], threshold: float) -> ImageInstances:
    """The single oysters of an answer. Of a mask, or of probabilities from `threshold` on, each connected component
    (by edges and corners) is one, its score the mean probability in it; 1 where there are no probabilities."""
    if isinstance(answer, Detections):
        return _detections(answer, method, shape)
    estimate = segmentation_of(answer, method)
    mask = np.ascontiguousarray(estimate.mask(threshold))
    count, numbers = cv2.connectedComponents(mask.view(np.uint8), connectivity=8)
    scores = np.ones(count)
    if estimate.probability is not None:
        pixels = np.maximum(np.bincount(numbers.ravel(), minlength=count), 1)
        scores = np.bincount(numbers.ravel(), weights=estimate.probability.ravel(), minlength=count) / pixels
    return from_planes(answer.name, np.asarray(numbers, np.int32), scores=dict(enumerate(scores.tolist())))


def _detections(answer: Detections, method: str, shape: tuple[int, int]) -> ImageInstances:
    scores = np.asarray(answer.scores, dtype=float).ravel()
    given = [one for one in (answer.numbers, answer.masks, answer.boxes) if one is not None]
    if len(given) != 1:
        raise MethodError(
            f"method {method!r} on {answer.name}: expected one of numbers, masks and boxes, got {len(given)}"
        )
    if answer.numbers is not None:
        if int(answer.numbers.max(initial=0)) > len(scores):
            raise MethodError(
                f"method {method!r} on {answer.name}: expected a score for each of "
                f"{int(answer.numbers.max())} oysters, got {len(scores)}"
            )
        return from_planes(answer.name, answer.numbers, scores=dict(enumerate(scores.tolist(), start=1)))
    if len(given[0]) != len(scores):
        raise MethodError(
            f"method {method!r} on {answer.name}: expected a score for each of {len(given[0])} oysters, got "
            f"{len(scores)}"
        )
    if answer.masks is not None:
        height, width = answer.masks.shape[1:]
        pairs = zip(answer.masks, scores.tolist(), strict=True)
        return ImageInstances(answer.name, height, width, tuple(from_mask(m, s) for m, s in pairs if m.any()))
    boxes = np.asarray(answer.boxes, dtype=float).reshape(-1, 4)
    if not np.isfinite(boxes).all() or (boxes[:, 2:] < 0).any():
        raise MethodError(
            f"method {method!r} on {answer.name}: expected boxes x, y, width, height in px, got {boxes[:1]}"
        )
    found = [
        Instance((x, y, w, h), None, w * h, score)
        for (x, y, w, h), score in zip(boxes.tolist(), scores.tolist(), strict=True)
    ]
    return ImageInstances(answer.name, *shape, tuple(found))
