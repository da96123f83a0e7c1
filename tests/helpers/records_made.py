"""Records that no method made: a few boards with ties, failures, nasty names, a newer version and a withdrawal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.evaluate.detection import DetectionSettings
from oysterbench.evaluate.segmentation import SegmentationSettings
from oysterbench.evaluate.slam.settings import SlamSettings
from oysterbench.hub.canonical import canonical, sha256
from oysterbench.results.records import ResultRecord
from oysterbench_leaderboard.storage.curves import curves_document
from oysterbench_leaderboard.storage.record import Record, Tier
from oysterbench_leaderboard.storage.store import RecordStore, StatusChange

STREAMS = Streams(20261120).at("tests", "leaderboard")

NASTY = (
    ("<script>alert(1)</script>", '"><img src=x onerror=alert(2)>'),
    ("=cmd|' /C calc'!A0", "@SUM(1+1)*cmd"),
    ("\\input{/etc/passwd}", "100 % {sure} & $x_1$ ^~#"),
)
"""Names of methods and teams that are harmless where every page, table and file escapes them."""

SLAM_SEQUENCES: dict[str, tuple[str, str, str, str, float]] = {
    "val-01": ("clear", "sun with caustics", "dense", "lawnmower, calm", 8.465),
    "val-02": ("clear", "overcast", "dense", "inspection, calm", 7.773),
    "val-03": ("clear", "sun", "dense", "transect, disturbed", 6.114),
    "val-04": ("clear", "sun with caustics", "dense", "free, disturbed", 4.646),
    "val-05": ("clear", "sun", "sparse", "loop, calm", 4.646),
    "val-06": ("murky", "overcast", "dense", "orbit, disturbed", 2.938),
    "val-07": ("murky", "sun", "dense", "lawnmower, disturbed", 1.929),
    "val-08": ("murky", "lamps", "dense", "free, disturbed", 2.0),
}
"""Sequence -> water, light, density, motion and Secchi depth in m."""

SEGMENTATION_SEQUENCES = {f"clip-{i:02d}": ("clear", "sun", "dense", "still", 6.0) for i in range(1, 7)}

STEERING_SEQUENCES = {f"dive-{i:02d}": ("clear", "sun", "dense", "free, calm", 6.0) for i in range(1, 7)}

HARDWARE = {"cpu": "a processor", "cores": 2, "platform": "Linux", "python": "3.11"}


def conditions_made(sequence: str) -> dict[str, float | str]:
    """Of one of the sequences above."""
    water, light, density, motion, secchi_m = {**SLAM_SEQUENCES, **SEGMENTATION_SEQUENCES, **STEERING_SEQUENCES}[
        sequence
    ]
    return {"water": water, "light": light, "density": density, "motion": motion, "secchi_m": secchi_m}


def slam_metrics(method: str, sequence: str, run: int, skill: float) -> dict[str, float]:
    """Metrics that belong together; skill: about the score (0 to 1). The error of a sequence is its own, so that
    methods of nearly one skill do not differ significantly."""
    shared = STREAMS.generator("slam", sequence).normal()
    own = STREAMS.generator("slam", sequence, method, run).normal(size=3)
    score = 1 / (1 + math.exp(-(math.log(skill / (1 - skill)) + 0.5 * shared + 0.3 * own[0])))
    percent = 1 / score - 1
    length_m, duration_s = 25.0 + 3.0 * len(sequence), 70.0
    wall_s = 60.0 * math.exp(0.3 * own[1])
    return {
        "score": score,
        "recall_1percent": min(1.0, score * 1.1),
        "ate_rmse_m": percent * length_m / 100,
        "ate_percent": percent,
        "ate_rotation_rmse_deg": 3 * percent,
        "rpe_1s_translation_rmse_m": 0.01 * percent,
        "rpe_1s_rotation_rmse_deg": 0.2 * percent,
        "coverage": 1 - 0.01 * abs(own[2]),
        "path_length_m": length_m,
        "duration_s": duration_s,
        "wall_s": wall_s,
        "cpu_s": 1.5 * wall_s,
        "realtime_factor": duration_s / wall_s,
        "peak_memory_mb": 400.0,
    }


def segmentation_metrics(method: str, sequence: str, run: int, skill: float) -> dict[str, float]:
    """Metrics that belong together, with the weights of the ratios over the data set."""
    own = STREAMS.generator("segmentation", sequence, method, run).normal(size=2)
    iou = min(0.99, max(0.01, skill + 0.03 * own[0]))
    area = 4e5 * (1 + len(sequence) % 3)
    return {
        "iou": iou,
        "image_iou": iou * 0.97,
        "boundary_iou": iou * 0.8,
        "precision": min(1.0, iou * 1.1),
        "recall": min(1.0, iou * 1.05),
        "dice": 2 * iou / (1 + iou),
        "empty_false_positive_rate": 0.01,
        "union_px": area,
        "scored_images": 40.0,
        "boundary_union_px": area / 8,
        "estimate_px": area * 0.8,
        "truth_px": area * 0.9,
        "dice_px": area * 1.7,
        "empty_px": area,
    }


def detection_metrics(method: str, sequence: str, run: int, skill: float) -> dict[str, float]:
    """Metrics that belong together; each sequence has one vote."""
    own = STREAMS.generator("detection", sequence, method, run).normal(size=2)
    ap = min(0.99, max(0.01, skill + 0.03 * own[0]))
    return {
        "ap_mask": ap,
        "ap50_mask": min(1.0, 1.5 * ap),
        "ap_box": ap * 1.05,
        "ar_mask": min(1.0, ap * 1.1),
        "pq": ap * 0.9,
        "count_mae": 20 * (1 - ap),
        "count_bias": 3 * own[1],
        "density_error_per_m2": 10 * own[1],
        "count_truth": 100.0,
        "images": 40.0,
    }


def steering_metrics(method: str, sequence: str, run: int, skill: float) -> dict[str, float]:
    """Metrics that belong together; a skill below 0 is worse than chance."""
    own = STREAMS.generator("steering", sequence, method, run).normal(size=2)
    reached = skill + 0.03 * own[0]
    axis = {f"{a}_{k}": v for a in ("yaw", "pitch") for k, v in (("accuracy", 0.3), ("macro_f1", 0.25))}
    costs = {"yaw_cost_deg": 9.0 - 4 * reached, "pitch_cost_deg": 7.0 - 4 * reached}
    return {"skill": reached, "regret_oysters": 5 * (1 - reached), **axis, **costs, "pictures": 125.0}


MADE = {
    "slam": (SLAM_SEQUENCES, slam_metrics, SlamSettings().as_dict(), "slam 3"),
    "segmentation": (SEGMENTATION_SEQUENCES, segmentation_metrics, SegmentationSettings().as_dict(), "segmentation 1"),
    "detection": (SEGMENTATION_SEQUENCES, detection_metrics, DetectionSettings().as_dict(), "detection 1"),
    "steering": (STEERING_SEQUENCES, steering_metrics, {}, "navigation 1"),
}


def record_made(
    method: str = "carp",
    team: str = "reef lab",
    skill: float = 0.8,
    *,
    track: str = "slam",
    split: str = "slam-val",
    runs: int = 1,
    evaluator: str = "",
    tier: Tier = "scored",
    failed: tuple[str, ...] = (),
    without: tuple[str, ...] = (),
    created: str = "2026-11-01T12:00:00Z",
    method_settings: Mapping[str, Any] | None = None,
    **of_record: Any,
) -> Record:
    """A record on all sequences of its track but those `without`; runs on the sequences `failed` gave nothing."""
    sequences, metrics, settings, newest = MADE[track]
    results = []
    for sequence in sequences:
        for run in range(0 if sequence in without else runs):
            ok = sequence not in failed
            results.append(
                ResultRecord(
                    track=track,
                    split=split,
                    sequence=sequence,
                    method=method,
                    metrics=metrics(method, sequence, run, skill) if ok else {},
                    failure=None if ok else "lost track after 3 s and gave no pose",
                    split_digest={"slam": "5a", "steering": "9e"}.get(track, "7c") * 32,
                    truth_digest="ab" * 32,
                    conditions=conditions_made(sequence),
                    run=run,
                    seed=run + 1,
                    method_settings=dict(method_settings or {"window_s": 4.0}),
                    settings=settings,
                    evaluator_version=evaluator or newest,
                    oysterbench_version="0.1",
                    hardware=HARDWARE,
                    created=created,
                )
            )
    return Record(method=method, team=team, tier=tier, results=tuple(results), created=created, **of_record)


def _scaled_to(drift: Array, stamps: int, metrics: Mapping[str, float]) -> float:
    """Factor of a drift (N, 3), at N of all stamps, with which it gives the score that is among the metrics."""
    shares = np.linalg.norm(drift, axis=1) / (0.01 * metrics["path_length_m"])
    low, high = 0.0, 1.0
    for _ in range(30):
        middle = (low + high) / 2
        better = np.sum(1 / (1 + middle * shares)) / stamps > metrics["score"]
        low, high = (middle, high) if better else (low, middle)
    return low


def curves_made(method: str, skill: float) -> dict[str, Any]:
    """Paths on the sequences of slam-val: a loop, and what drifts away from it so far as the score of the method's
    first run says; without an answer for a while on the last one."""
    t_s = np.linspace(0.0, 70.0, 141)
    angle = 2 * np.pi * t_s / 70.0
    sequences = {}
    for k, name in enumerate(SLAM_SEQUENCES):
        truth = np.stack([4 * np.cos(angle), 2.5 * np.sin(2 * angle), -3.5 + 0.2 * np.sin(5 * angle + k)], axis=1)
        missed = slice(60, 70) if name == "val-08" else slice(0)
        drift = STREAMS.generator("curves", method, name).normal(size=(len(t_s), 3)).cumsum(axis=0)
        drift *= _scaled_to(np.delete(drift, missed, axis=0), len(t_s), slam_metrics(method, name, 0, skill))
        path, error_m = (truth + drift).round(3).tolist(), np.linalg.norm(drift, axis=1).round(3).tolist()
        for i in range(len(t_s))[missed]:
            path[i] = error_m[i] = None
        values = {"run": 0, "t_s": t_s.round(3).tolist(), "truth": truth.round(3).tolist()}
        sequences[name] = {**values, "path": path, "error_m": error_m}
    return curves_document(sequences, "posyaw")


CURVES = {"carp2": ("carp", 0.84), "cod": ("cod", 0.83), "nasty0": (NASTY[0][0], 0.5)}
"""Short names of the records that have curves -> what these are made of."""


DATA_SET = {
    "method": "boxes",
    "clips": 6,
    "metrics": {"ap_mask": 0.21, "ap_box": 0.22},
    "reasons": {},
    "intervals": {"ap_mask": {"low": 0.18, "high": 0.25, "reason": ""}},
}
"""What `oysterbench eval` says of all clips at once."""


def records_made() -> dict[str, Record]:
    """A small leaderboard by short names.

    On slam-val "carp" and "cod" do not differ significantly, "drift" is far behind, "eel" failed on two sequences and
    "gap" was not run on one; "carp2" takes the place of "carp1", "fraud" is to be withdrawn (`fill`), three names are
    nasty. "old" is of an earlier evaluator. Two methods are on a board of segmentation, two on one of steering, of
    which "straight" is worse than chance, and one on one of detection, whose AP over all images is no mean of clips.
    """
    named: dict[str, Any] = {"skill": 0.84, "runs": 3, "tier": "baseline", "url": "https://example.org/carp"}
    segmented: dict[str, Any] = {"track": "segmentation", "split": "seg-val", "tier": "baseline"}
    found = {
        "carp1": record_made(**named, created="2026-10-01T09:00:00Z", summary="Smooths a short window."),
        "cod": record_made("cod", "harbour group", 0.83, runs=2, created="2026-11-02T08:00:00Z"),
        "drift": record_made("drift", skill=0.2, tier="baseline", created="2026-10-03T10:00:00Z"),
        "eel": record_made("eel", "harbour group", 0.7, failed=("val-07", "val-08"), created="2026-10-04T10:00:00Z"),
        "gap": record_made("gap", "harbour group", 0.75, without=("val-08",), created="2026-10-05T10:00:00Z"),
        "fraud": record_made("fraud", "somebody", 0.99, tier="reported", created="2026-10-06T10:00:00Z"),
        "old": record_made("drift", skill=0.25, evaluator="slam 2", tier="baseline", created="2026-08-01T10:00:00Z"),
        "unet": record_made("unet", skill=0.71, **segmented, data_set={"metrics": {"iou": 0.7}}),
        "colour": record_made("colour", skill=0.4, **segmented),
        "boxes": record_made("boxes", skill=0.3, track="detection", split="seg-val", data_set=DATA_SET),
        "steer": record_made("steer", skill=0.5, track="steering", split="steer-val", tier="baseline"),
        "straight": record_made("straight", skill=-0.1, track="steering", split="steer-val", tier="baseline"),
    }
    earlier: dict[str, Any] = {"supersedes": found["carp1"].digest, "reason": "A longer window."}
    found["carp2"] = record_made(**named, summary="Smooths a window.", **earlier)
    for i, (method, team) in enumerate(NASTY):
        text: dict[str, Any] = {
            "summary": f"{method} by {team}",
            "url": 'https://example.org/?a="><script>alert(3)</script>',
        }
        found[f"nasty{i}"] = record_made(method, team, 0.5 - 0.1 * i, created=f"2026-10-1{i}T00:00:00Z", **text)
    for name, made_of in CURVES.items():
        found[name] = replace(found[name], curves=sha256(canonical(curves_made(*made_of))))
    return found


def fill(store: RecordStore, records: Mapping[str, Record] | None = None) -> dict[str, str]:
    """Add the records, with their curves, to a store, and withdraw the fraud; short name -> digest."""
    for made_of in CURVES.values():
        store.add_curves(curves_made(*made_of))
    digests = {name: store.add(record) for name, record in (records or records_made()).items()}
    if "fraud" in digests:
        reason = "The estimates were made from the truth."
        store.add_status_change(StatusChange(digests["fraud"], "withdrawn", reason, "2026-11-05T00:00:00Z"))
    return digests
