"""How far the truth of a hidden split comes back from what a hundred submissions are told.

    python -m tests.benchmarks.reconstruction

An attacker who knows how everything is scored sends one chosen answer after the other and reads the truth off what is
told. Two ways of telling: `full`, all metrics of each sequence at four digits and counts as they are; and `told`, what
`leaderboard/publishing/hidden.py` leaves. Of the latter each attack is tried on all sequences at once, by their
scores, and on one sequence after the other, by the means that are then of that one; the better counts.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.detection import DetectionScorer
from oysterbench.evaluate.detection.instances import ImageInstances, from_planes
from oysterbench.evaluate.segmentation import ClipScorer, EstimateImage, TruthImage
from oysterbench.evaluate.slam.scoring import score
from oysterbench.evaluate.steering import Commands, Labels, score_pictures
from oysterbench.recipe.steering import SteeringRecipe
from oysterbench.results.records import ResultRecord
from oysterbench_leaderboard.publishing.hidden import LEAST_ESTIMATE, discreet
from tests.helpers.pool import path

SUBMISSIONS = 100
SEQUENCES = 10

Told = Callable[[Sequence[ResultRecord]], Mapping[tuple[int, str], float]]
"""Results -> sequence, -1 for the whole split, and metric -> what is told."""


def full(results: Sequence[ResultRecord]) -> dict[tuple[int, str], float]:
    """Every metric of each sequence, to four digits."""
    found = {(int(r.sequence), key): float(value) for r in results for key, value in r.metrics.items()}
    return {key: v if v.is_integer() else float(f"{v:.4g}") for key, v in found.items() if math.isfinite(v)}


def told(results: Sequence[ResultRecord]) -> dict[tuple[int, str], float]:
    """What is told of a hidden split."""
    coarse, whole = discreet(results)
    found = {(int(r.sequence), key): float(value) for r in coarse for key, value in r.metrics.items()}
    return found | {(-1, key): value for key, value in whole["means"].items() if value is not None}


def result(track: str, sequence: int, found) -> ResultRecord:
    """Of a sequence's score, or clip."""
    about = {"metrics": found.metrics, "reasons": found.reasons}
    return ResultRecord(track=track, split="s", sequence=str(sequence), method="m", **about)


def likeliest(value: float, weights: NDArray[np.floating], worths: NDArray[np.floating]) -> tuple[int, ...]:
    """The choice of one of `worths` (C,) for each of `weights` (k,) whose weighed sum is nearest to a value."""
    choices = list(itertools.product(range(len(worths)), repeat=len(weights)))
    return choices[int(np.argmin(np.abs(worths[np.array(choices)] @ weights - value)))]


def rounds(at_once: bool, pieces: int, each: int) -> list[tuple[list[int], list[int]]]:
    """Sequences and pieces of each submission but the first: all sequences at once, or one after the other."""
    sequences = [list(range(SEQUENCES))] if at_once else [[s] for s in range(SEQUENCES)]
    starts = range(0, pieces, each)
    asked = [(some, list(range(i, min(i + each, pieces)))) for some in sequences for i in starts]
    return asked[: SUBMISSIONS - (1 if at_once else len({some[0] for some, _ in asked[:SUBMISSIONS]}))]


# Masks: an attacker who has every outline, and does not know which of them are oysters.

BLOBS, IMAGES, MOST_PX = 400, 10, 240


class Masks:
    """Blobs, half of which are oysters. areas, px, true: (SEQUENCES, BLOBS)."""

    def __init__(self, seed: int = 1) -> None:
        rng = np.random.default_rng(seed)
        self.areas = rng.integers(60, MOST_PX, (SEQUENCES, BLOBS))
        self.true = rng.random((SEQUENCES, BLOBS)) < 0.5

    def picture(self, sequence: int, image: int, shown: np.ndarray) -> np.ndarray:
        """(BLOBS / IMAGES, 2 MOST_PX) of those of the blobs (BLOBS,) that are shown: a row of pixels for each."""
        rows = np.split(np.arange(BLOBS), IMAGES)[image]
        return np.arange(2 * MOST_PX) < (self.areas[sequence] * shown)[rows, None]

    def results(self, called: np.ndarray, sequences: Sequence[int]) -> list[ResultRecord]:
        """Of the blobs (SEQUENCES, BLOBS) that are called oysters."""
        return [self.scored(s, self.areas[s] * called[s]) for s in sequences]

    def scored(self, sequence: int, sizes: np.ndarray, wrong_px: int = 0) -> ResultRecord:
        """Of the first pixels of each blob of a sequence, sizes (BLOBS,), and of some that no blob has."""
        scorer = ClipScorer()
        for k, rows in enumerate(np.split(np.arange(BLOBS), IMAGES)):
            classes = np.where(self.picture(sequence, k, self.true[sequence]), 2, 1).astype(np.uint8)
            oyster = np.arange(2 * MOST_PX) < sizes[rows, None]
            oyster[:, MOST_PX:] = np.arange(len(rows) * MOST_PX).reshape(-1, MOST_PX) < wrong_px / IMAGES
            scorer.add(TruthImage(str(k), classes), EstimateImage(str(k), oyster=oyster))
        return result("segmentation", sequence, scorer.result())

    def iou(self, called: np.ndarray) -> float:
        both, either = self.areas[called & self.true].sum(), self.areas[called | self.true].sum()
        return float(both / either)

    def hits(self, seen: Mapping[tuple[int, str], float], sequence: int, called: np.ndarray, one: bool) -> float:
        """Pixels that are rightly called, as they follow from what is told."""
        size = float(self.areas[sequence][called[sequence]].sum())
        if one:
            return seen[-1, "precision"] * size
        if (sequence, "estimate_px") in seen:
            return seen[sequence, "truth_px"] + size - seen[sequence, "union_px"]
        iou = seen[sequence, "iou"]
        return iou * (seen[sequence, "truth_px"] + size) / (1 + iou)

    def attack(self, publish: Told, at_once: bool, each: int) -> float:
        """IoU of what comes back; each: blobs that a submission leaves out of a sequence."""
        everything = np.ones((SEQUENCES, BLOBS), bool)
        guess = everything.copy()
        base: dict[int, float] = {}
        for some, blobs in rounds(at_once, BLOBS, each):
            if some[0] not in base:
                seen = publish(self.results(everything, some))
                base |= {s: self.hits(seen, s, everything, not at_once) for s in some}
            called = everything.copy()
            called[:, blobs] = False
            seen = publish(self.results(called, some))
            for s in some:
                lost = base[s] - self.hits(seen, s, called, not at_once)
                guess[s, blobs] = likeliest(lost, self.areas[s, blobs].astype(float), np.array([0.0, 1.0]))
        return self.iou(guess)

    def binary(self, publish: Told, each: int, padding: float = 0.0) -> float:
        """IoU of what comes back by answering a few blobs of one sequence and nothing else, cut to sizes of which each
        is twice the one before: how many pixels are right, which the precision tells, is then the answer in binary.

        each: blobs of a submission; padding: pixels of no blob that are called oysters as well, as a share of the true
        ones, so that the estimate is not too small to be told of
        """
        guess = np.ones((SEQUENCES, BLOBS), bool)
        sizes = 2 ** np.arange(each) * int(0.8 * MOST_PX / 2 ** (each - 1))
        wrong_px = round(padding * self.areas.sum() / 2 / SEQUENCES / IMAGES) * IMAGES
        nothing = np.zeros(BLOBS, int)
        silent = [self.scored(s, nothing, wrong_px) for s in range(SEQUENCES)]
        largest = np.argsort(-self.areas, axis=1)
        for k in range(SUBMISSIONS):
            s, first = k % SEQUENCES, each * (k // SEQUENCES)
            blobs = largest[s, first : first + each]
            cut = nothing.copy()
            cut[blobs] = np.minimum(sizes, self.areas[s, blobs])
            seen = publish([*silent[:s], self.scored(s, cut, wrong_px), *silent[s + 1 :]])
            if (-1, "precision") not in seen:
                continue
            hits = seen[-1, "precision"] * (cut.sum() + SEQUENCES * wrong_px)
            guess[s, blobs] = likeliest(hits, cut[blobs].astype(float), np.array([0.0, 1.0]))
        return self.iou(guess)


class Detections(Masks):
    """The same blobs as single oysters."""

    def instances(self, image: int, sizes: np.ndarray, scores: np.ndarray | None = None) -> ImageInstances:
        """Of the first pixels of some blobs, sizes (BLOBS,) with 0 for none; scores (BLOBS,), the truth has none."""
        rows = np.split(np.arange(BLOBS), IMAGES)[image]
        numbers = np.arange(1, len(rows) + 1)[:, None] * (np.arange(2 * MOST_PX) < sizes[rows, None])
        sure = None if scores is None else dict(enumerate(scores[rows].tolist(), start=1))
        return from_planes(str(image), numbers, scores=sure)

    def detected(self, sizes: np.ndarray, scores: np.ndarray, sequences: Sequence[int]) -> list[ResultRecord]:
        """Of the first pixels of blobs with scores, as above for each sequence; both (SEQUENCES, BLOBS)."""
        made = []
        for s in sequences:
            scorer = DetectionScorer()
            for k in range(IMAGES):
                truth = self.instances(k, self.areas[s] * self.true[s])
                scorer.add(truth, self.instances(k, sizes[s], scores[s]))
            made.append(result("detection", s, scorer.result()))
        return made

    def attack(self, publish: Told, at_once: bool, each: int) -> float:
        """IoU of what comes back; each: blobs of a sequence that are answered with, each cut to an overlap of its own,
        so that the panoptic quality is their weighed sum."""
        guess = np.ones((SEQUENCES, BLOBS), bool)
        sure = np.ones(guess.shape)
        overlaps = 1 - 0.48 * 0.5 ** np.arange(each)
        truths: dict[int, float] = {}
        for some, blobs in rounds(at_once, BLOBS, each):
            if some[0] not in truths:
                seen = publish(self.detected(self.areas, sure, some))
                quality = {s: seen[s if at_once else -1, "pq"] for s in some}
                truths |= {s: round(BLOBS * q / (2 - q)) for s, q in quality.items()}
            sizes = np.zeros_like(self.areas)
            sizes[:, blobs] = np.ceil(self.areas[:, blobs] * overlaps[: len(blobs)])
            seen = publish(self.detected(sizes, sure, some))
            for s in some:
                total = seen[s if at_once else -1, "pq"] * (len(blobs) + truths[s]) / 2
                weights = sizes[s, blobs] / self.areas[s, blobs]
                guess[s, blobs] = likeliest(total, weights, np.array([0.0, 1.0]))
        return self.iou(guess)


# Commands: probabilities make the told costs a weighed sum of the labels.

YAW_DEG, PITCH_DEG = (30.0, 20.0, 10.0, 0.0, -10.0, -20.0, -30.0), (-24.0, -16.0, -8.0, 0.0, 8.0, 16.0, 24.0)
TASK = SteeringRecipe(yaw_deg=YAW_DEG, pitch_deg=PITCH_DEG, altitude_m=(0.5, 1.4))
PICTURES, CLASSES = 50, 7
LIKELY = np.array([1, 2, 3, 4, 3, 2, 1]) / 16


class Steering:
    """Labelled pictures. labels: (SEQUENCES, PICTURES, 2), more often straight on than not."""

    def __init__(self, seed: int = 2) -> None:
        rng = np.random.default_rng(seed)
        self.labels = rng.choice(CLASSES, (SEQUENCES, PICTURES, 2), p=LIKELY)
        y, p = np.mgrid[:CLASSES, :CLASSES]
        far = np.hypot(y - self.labels[..., :1, None], p - self.labels[..., 1:, None])
        self.worth = 9 - far + rng.uniform(0, 0.2, far.shape) * (far > 0)

    def results(self, first: np.ndarray, sequences: Sequence[int]) -> list[ResultRecord]:
        """Of the probability (PICTURES,) of the first class of both axes; the last has the rest."""
        probability = np.zeros((PICTURES, CLASSES))
        probability[:, 0], probability[:, -1] = first, 1 - first
        classes = np.repeat(probability.argmax(axis=1)[:, None], 2, axis=1)
        commands = Commands(classes, probability, probability)
        truths = {s: Labels(self.labels[s], self.worth[s], TASK) for s in sequences}
        return [result("steering", s, score_pictures(truth, commands)) for s, truth in truths.items()]

    def right(self, guess: np.ndarray) -> float:
        """Share of pictures whose label is known in both axes."""
        return float((guess == self.labels).all(axis=-1).mean())

    def attack(self, publish: Told, at_once: bool, each: int) -> float:
        """Share of labels that come back; each: pictures of a sequence that a submission asks about."""
        guess = np.full(self.labels.shape, CLASSES // 2)
        step = {"yaw": 10.0, "pitch": 8.0}
        base: dict[int, Mapping[tuple[int, str], float]] = {}
        weights = (1.0 / CLASSES) ** np.arange(each)
        for some, pictures in rounds(at_once, PICTURES, each):
            if some[0] not in base:
                seen = publish(self.results(np.zeros(PICTURES), some))
                base |= dict.fromkeys(some, seen)
            first = np.zeros(PICTURES)
            first[pictures] = weights[: len(pictures)]
            seen = publish(self.results(first, some))
            for s, (k, axis) in itertools.product(some, enumerate(step)):
                key = (s if at_once else -1, f"{axis}_cost_deg")
                if key not in seen:
                    continue
                moved = (seen[key] - base[s][key]) * PICTURES / step[axis]
                found = likeliest(moved, weights[: len(pictures)], 2.0 * np.arange(CLASSES) - (CLASSES - 1))
                guess[s, pictures, k] = found
        return self.right(guess)

    def climb(self, publish: Told, seed: int = 4) -> float:
        """Share of labels that come back by the scores alone: what raises the told skill is kept."""
        rng = np.random.default_rng(seed)
        best = np.full(self.labels.shape, CLASSES // 2)
        skills = [-math.inf] * SEQUENCES
        for picture in range(-1, min(PICTURES, SUBMISSIONS - 1)):
            tried = best.copy()
            if picture >= 0:
                tried[:, picture] = rng.choice(CLASSES, (SEQUENCES, 2), p=LIKELY)
            made = []
            for s in range(SEQUENCES):
                yaw, pitch = np.eye(CLASSES)[tried[s]].swapaxes(0, 1)
                truth = Labels(self.labels[s], self.worth[s], TASK)
                made.append(result("steering", s, score_pictures(truth, Commands(tried[s], yaw, pitch))))
            seen = publish(made)
            for s in range(SEQUENCES):
                if seen[s, "skill"] > skills[s]:
                    best[s], skills[s] = tried[s], seen[s, "skill"]
        return self.right(best)


# Paths: a part that is moved tells how far off it was, by how the mean square error changes.

PARTS, MOVE_M = 33, 0.05


class Paths:
    """Estimates whose error winds along the path, 0.2 m on each axis."""

    def __init__(self, seed: int = 3) -> None:
        rng = np.random.default_rng(seed)
        self.true = [path(s) for s in range(SEQUENCES)]
        self.start = []
        for true in self.true:
            t = np.linspace(0, 2 * np.pi, len(true.stamps_ns))[:, None]
            error = sum(0.12 * np.sin(n * t + rng.uniform(0, 7, 3)) for n in (1, 2, 3, 4))
            self.start.append(Trajectory(true.stamps_ns, true.positions + error, true.quaternions))
        self.parts = np.array_split(np.arange(len(self.true[0].stamps_ns)), PARTS)

    def results(self, paths: Mapping[int, Trajectory]) -> list[ResultRecord]:
        return [result("slam", s, score(self.true[s], one)) for s, one in paths.items()]

    def rmse(self, paths: Sequence[Trajectory]) -> float:
        """Root mean square error of all sequences, m."""
        errors = [score(true, one).metrics["ate_rmse_m"] for true, one in zip(self.true, paths, strict=True)]
        return float(np.sqrt(np.mean(np.square(errors))))

    def moved(self, one: Trajectory, part: int, axis: int, by: float) -> Trajectory:
        positions = one.positions.copy()
        positions[self.parts[part], axis] += by
        return Trajectory(one.stamps_ns, positions, one.quaternions)

    def attack(self, publish: Told, at_once: bool) -> float:
        """RMSE of what comes back, m, by the told error; at_once: of all sequences, else of the first."""
        some = range(SEQUENCES) if at_once else range(1)
        made = list(self.start)
        base = publish(self.results({s: self.start[s] for s in some}))
        for part, axis in itertools.product(range(PARTS), range(3)):
            seen = publish(self.results({s: self.moved(self.start[s], part, axis, MOVE_M) for s in some}))
            for s in some:
                n = len(self.parts[part])
                squares = (self.error(seen, s, at_once) ** 2 - self.error(base, s, at_once) ** 2) * len(
                    self.true[s].stamps_ns
                )
                off = (squares - n * MOVE_M**2) / (2 * n * MOVE_M)
                made[s] = self.moved(made[s], part, axis, -off)
        return self.rmse(made)

    def error(self, seen: Mapping[tuple[int, str], float], s: int, at_once: bool) -> float:
        """ATE, m; what is told in % of the path is so of the estimate's own length."""
        return seen[s, "ate_rmse_m"] if at_once else seen[-1, "ate_percent"] / 100 * self.start[s].path_length

    def climb(self, publish: Told, parts: int = 11, step_m: float = 0.15) -> float:
        """RMSE of what comes back of all sequences by their scores alone, m: what raises the score is kept."""
        self.parts = np.array_split(np.arange(len(self.true[0].stamps_ns)), parts)
        made, best = list(self.start), [0.0] * SEQUENCES
        tried = [(0, 0, 0.0), *itertools.product(range(parts), range(3), (step_m, -step_m, step_m))]
        for part, axis, by in tried[:SUBMISSIONS]:
            changed = {s: self.moved(made[s], part, axis, by) for s in range(SEQUENCES)}
            seen = publish(self.results(changed))
            for s in range(SEQUENCES):
                if seen[s, "score"] > best[s]:
                    made[s], best[s] = changed[s], seen[s, "score"]
        return self.rmse(made)


def figures() -> dict[str, tuple[float, float, float]]:
    """What is measured -> what the attacker begins with, and has in the end by `full` and by `told`."""
    masks, oysters, steering, paths = Masks(), Detections(), Steering(), Paths()
    return {
        "masks: IoU": (
            masks.iou(np.ones_like(masks.true)),
            masks.attack(full, True, 4),
            max(
                masks.attack(told, True, 1),
                masks.attack(told, False, 4),
                masks.binary(told, 8),
                *(masks.binary(told, each, LEAST_ESTIMATE) for each in (2, 3, 4)),
            ),
        ),
        "single oysters: IoU": (
            oysters.iou(np.ones_like(oysters.true)),
            oysters.attack(full, True, 5),
            max(oysters.attack(told, False, each) for each in (4, 6, 8)),
        ),
        "commands: share of labels": (
            steering.right(np.full_like(steering.labels, CLASSES // 2)),
            max(steering.attack(full, True, each) for each in (1, 2)),
            max(steering.climb(told), *(steering.attack(told, False, each) for each in (1, 2))),
        ),
        "paths: RMSE, m": (
            paths.rmse(paths.start),
            paths.attack(full, True),
            min(paths.attack(told, False), paths.climb(told)),
        ),
    }


def main() -> None:
    """Print the figures."""
    print(f"{SUBMISSIONS} submissions, {SEQUENCES} sequences: {'at first':>18} {'full':>9} {'told':>9}")
    for name, values in figures().items():
        print(f"{name:<43}" + " ".join(f"{value:9.3f}" for value in values))


if __name__ == "__main__":
    main()
