"""Files of weights that nobody trained, and their cards."""

from __future__ import annotations

import random
from pathlib import Path

from oysterbench.hub.model import Figure, Model, Origin, Training
from oysterbench.hub.publish_model import build_model, describe_weights, publish_model

PIECE = 1 << 12
SIZE = 20 * PIECE + 123
TRAINING = Training(
    data={"seg-train": "ab" * 32},
    steps=1000,
    seed=3,
    settings={"fit": {"steps": 1000, "learning_rate": 0.001}},
    device="cpu",
    parameters=4_000_000,
    loss=0.25,
    cpu_s=1200.0,
    versions={"torch": "2.13.0"},
    begun=Origin("EfficientNet-lite0 trained on ImageNet", "Apache License 2.0", "https://example.org/lite"),
)
FIGURE = Figure(
    method="unet",
    track="segmentation",
    split="seg-val",
    split_digest="cd" * 32,
    sequences=8,
    metric="iou",
    heading="IoU",
    unit="",
    better="higher",
    value=0.7123,
    evaluator="segmentation-1",
    results="ef" * 32,
    low=0.69,
    high=0.73,
)


def write_weights(path: Path, seed: int = 0, size: int = SIZE) -> Path:
    """Random bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(random.Random(seed).randbytes(size))
    return path


def card_of(
    path: Path,
    name: str = "unet",
    training: Training = TRAINING,
    version: str = "1.0",
    summary: str = "Where oysters are",
) -> Model:
    """The card of a file."""
    words = (summary, "Counting without a check.", "https://creativecommons.org/licenses/by/4.0/")
    file = describe_weights(name, path, PIECE)
    return build_model(name, version, ["unet", "unet_instances"], words, file, training, [FIGURE])


def release(tree: Path, path: Path, key, version: str = "1.0", name: str = "unet") -> Model:
    """Publish a file as a version of a model."""
    return publish_model(tree, card_of(path, name, version=version), path, key)
