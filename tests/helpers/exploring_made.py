"""Labelled pictures and rollouts made by hand: a sequence file, and logs that follow from commands alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd

from oysterbench.core.ros import EPOCH_NS
from oysterbench.evaluate.steering import RolloutLog
from oysterbench.methods.policy import commands
from oysterbench.methods.steering import VehicleState, View
from oysterbench.recipe import SplitRecipe, parse_split
from oysterbench.sensors.camera import KIND as CAMERA
from oysterbench.sensors.camera_messages import camera_info, camera_topics, colour_message
from oysterbench.sequence.read import CALIBRATION, METADATA, STEERING
from oysterbench.sequence.truth import TF, TRUTH_POSE, TRUTH_TYPES
from oysterbench.sequence.write import SequenceWriter
from tests.helpers.hand_made_dive import calibration

WIDTH, HEIGHT = 32, 24
YAW, PITCH = (30.0, 20.0, 10.0, 0.0, -10.0, -20.0, -30.0), (-24.0, -16.0, -8.0, 0.0, 8.0, 16.0, 24.0)

RIG = """
name = "explorer"
summary = "a small camera"
truth_rate_hz = 25.0

[imu]
grade = "mems"
rate_hz = 25.0

[[camera]]
name = "cam_front"
width = 32
height = 24
hfov_deg = 80.0
rate_hz = 0.5
layer_rate_hz = 0.5
layers = ["class", "instance"]
position_m = [0.2, 0.0, 0.0]
pitch_deg = 20.0
"""

SPLIT = f"""
name = "made"
version = "1.0"
track = "steering"
seed = 7
rig = "explorer"
summary = "two small reefs"

[steering]
yaw_deg = {list(YAW)}
pitch_deg = {list(PITCH)}
altitude_m = [0.5, 1.4]
rollout_s = 12.0
"""

REEF = """
[[sequence]]
name = "{name}"
duration_s = 20.0
reef = {{ size_m = 8.0, depth_m = 3.0, relief_rms_m = 0.05, oysters = 40, stones = 5 }}
water = {{ type = "{water}" }}
light = {{ sun_elevation_deg = 50.0, sun_azimuth_deg = 200.0 }}
path = {{ kind = "free", extent_m = 4.0, revisit = 0.0, speed_m_s = 0.5, altitude_m = 1.0 }}
"""


def made_split(reefs: tuple[str, ...] = ("one", "two"), rig: str = RIG) -> SplitRecipe:
    """A split of the track steering."""
    waters = ["1C" if k % 2 == 0 else "5C" for k in range(len(reefs))]
    text = SPLIT + "".join(REEF.format(name=name, water=water) for name, water in zip(reefs, waters, strict=True))
    return parse_split(text, "made.toml", rig_source=rig)


def label_table(pictures: int, seed: int = 0) -> pd.DataFrame:
    """Labels whose class is that of the greatest action value."""
    generator = np.random.default_rng(seed)
    action_values = np.round(generator.gamma(2.0, 4.0, (pictures, len(YAW), len(PITCH))), 4)
    best = action_values.reshape(pictures, -1).argmax(axis=1)
    table = pd.DataFrame(
        {
            "stamp_ns": EPOCH_NS + 2_000_000_000 * np.arange(pictures),
            "yaw": best // len(PITCH),
            "pitch": best % len(PITCH),
            "heading_rad": np.round(generator.uniform(-3, 3, pictures), 3),
            "pitch_rad": np.round(generator.uniform(-0.3, 0.3, pictures), 3),
            "depth_m": 2.0,
            "altitude_m": 1.0,
        }
    )
    keys = [f"value_{y}_{p}" for y in range(len(YAW)) for p in range(len(PITCH))]
    return pd.concat([table, pd.DataFrame(action_values.reshape(pictures, -1), columns=keys)], axis=1)


def picture(yaw: int, pitch: int) -> np.ndarray:
    """A picture in whose colour the expert's classes are written."""
    return np.full((HEIGHT, WIDTH, 3), (20 + 30 * yaw, 20 + 30 * pitch, 100), dtype=np.uint8)


def write_labelled(path: Path, name: str, table: pd.DataFrame | None, pictures: int | None = None) -> Path:
    """A sequence file with labelled pictures; without a table, unlabelled ones."""
    labels = label_table(pictures or 6) if table is None else table
    camera = {
        "width": WIDTH,
        "height": HEIGHT,
        "rate_hz": 0.5,
        "matrix": [[19.0, 0, 15.5], [0, 19.0, 11.5], [0, 0, 1]],
        "distortion_model": "plumb_bob",
        "distortion": [0.0, 0.0, 0.0, 0.0],
        "T_base_cam": np.eye(4).tolist(),
    }
    known = {"imu": calibration()["imu"], "cameras": {"cam_front": camera}}
    with open(path, "wb") as file:
        writer = SequenceWriter(
            file, {TRUTH_POSE: TRUTH_TYPES[TRUTH_POSE], TF: TRUTH_TYPES[TF], **camera_topics("cam_front", ())}
        )
        writer.metadata(METADATA, {"sequence": name, "split": "made", "split_version": "1.0"})
        writer.attachment(CALIBRATION, "application/json", json.dumps(known).encode())
        if table is not None:
            writer.attachment(STEERING, "text/csv", table.to_csv(index=False).encode())
        rows = list(labels[["stamp_ns", "yaw", "pitch"]].itertuples(index=False))[: pictures or len(labels)]
        for stamp, _, _ in rows:
            writer.write(camera_info(int(stamp), "cam_front", CAMERA.read_calibration(camera)))
        for stamp, yaw, pitch in rows:
            writer.write(colour_message(int(stamp), "cam_front", picture(int(yaw), int(pitch)), 95, "png"))
        writer.finish()
    return path


def made_log(
    reef: str, policy: str, steps: int, gains: list[int], oysters: int = 40, half_m: float = 3.0
) -> RolloutLog:
    """A rollout in which `gains` oysters are seen at each moment, to which zeros are added; the path is a circle."""
    seen = np.array((gains + [0] * (steps + 1))[: steps + 1], dtype=np.int64)
    angle = np.arange(steps + 1) * 0.2
    states = np.column_stack([np.cos(angle), np.sin(angle), np.full(steps + 1, -2.0), angle + np.pi / 2, 0 * angle])
    generator = np.random.default_rng(oysters)
    found = np.arange(oysters) < seen.sum()
    return RolloutLog(
        reef=reef,
        policy=policy,
        step_s=1.0,
        states=states,
        altitude=np.full(steps + 1, 1.0),
        commands=np.full((steps, 2), 3, dtype=np.int64),
        seen=seen,
        contact=np.zeros(steps + 1, dtype=bool),
        turned=np.zeros(steps + 1, dtype=bool),
        covered=np.linspace(0.1, 0.5, steps + 1),
        half_m=half_m,
        oysters=np.column_stack([generator.uniform(-half_m, half_m, (oysters, 2)), np.full(oysters, -3.0)]),
        found=found,
        wall_s=0.5,
        cpu_s=0.4,
    )


RATES = {"expert": 3, "lawnmower": 2, "random": 1}
"""Oysters that a reference sees at each moment."""


def made_explore(split, reef, policy, *, salt=b"", seconds=None, start=0, device="cpu", progress=None, teacher=False):
    """In place of `oysterbench.exploration.explore`: no picture is rendered, and a method sees an oyster a moment."""
    steps = round(seconds / split.steering.step_s)
    if isinstance(policy, str):
        return made_log(reef, policy, steps, [RATES[policy]] * (steps + 1)), []
    views = (
        View(f"{k:06d}", picture(3, 3), VehicleState(0.0, 0.0, 2.0, 1.0), float(k)) for k in range(steps)
    )  # fmt: skip
    done = sum(1 for _ in commands(policy, split.steering, views, reef))
    return made_log(reef, policy.name, done, [1] * (done + 1)), []
