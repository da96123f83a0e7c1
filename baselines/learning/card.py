"""Description of a training, read from its checkpoint, for the card of a release."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from oysterbench.core.errors import MethodError
from oysterbench.hub.model import Origin, Training
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_finished
from oysterbench_baselines.moving.labels import SET as MOVING

LAST = 50
"""Number of final steps over which the loss is averaged."""
BEGUN_LICENCE = "under the licence of those weights"
ENCODER_LICENCE = "Apache License 2.0; learnt from ImageNet, whose pictures are for research and teaching"
ENCODER_SOURCE = "https://github.com/tensorflow/tpu/tree/master/models/official/efficientnet/lite"


def describe(name: str, path: Path) -> Training:
    """Describe how the weights `name` in a checkpoint were trained.

    Raises MethodError where the file is not a checkpoint, or is one of another or an unfinished training.
    """
    checkpoint = read_weights(name, path)
    if not kind_of(checkpoint):
        raise MethodError(f"{path}: expected weights of {name}, got those of a training that is not known")
    identity = checkpoint.identity
    return Training(
        data=all_data_of(identity),
        steps=checkpoint.step,
        seed=int(identity["seed"]),
        settings={"network": plain(checkpoint.network), **plain(identity["settings"])},
        device=str(identity.get("device", "cpu")),
        parameters=sum(_numbers(checkpoint.weights)),
        loss=float(np.mean(checkpoint.losses[-LAST:])),
        cpu_s=round(checkpoint.seconds, 1),
        versions=dict(checkpoint.versions),
        begun=origin_of(identity, str(checkpoint.network.get("encoder") or "")),
    )


def read_weights(name: str, path: Path) -> Checkpoint:
    """Read the checkpoint of a finished training. Raises MethodError where there is none, or it is known to be of other
    weights than `name`."""
    checkpoint = read_finished(path)
    if (found := kind_of(checkpoint)) not in ("", name):
        raise MethodError(f"{path}: expected weights of {name}, got those of {found}")
    return checkpoint


def kind_of(checkpoint: Checkpoint) -> str:
    """Name of the weights that a checkpoint holds; empty where its training is not known."""
    identity = checkpoint.identity
    if {"source", "target"} <= set(identity):
        return "cut"
    method = str(identity.get("method", ""))
    data = data_of(identity)
    return "moving" if method.startswith("unet") and data and all(name.startswith(MOVING) for name in data) else method


def data_of(identity: Mapping[str, Any]) -> dict[str, str]:
    """Training data: name -> digest."""
    known = identity.get("data") or {key: identity[key] for key in ("source", "target") if key in identity}
    return {str(name): str(digest) for name, digest in known.items()}


def all_data_of(identity: Mapping[str, Any]) -> dict[str, str]:
    """Training data, those of the trainings from whose weights it began included: name -> digest. Where earlier data
    have the name of other, later ones, that is said."""
    own, before = data_of(identity), all_data_of(identity["begun"]) if "begun" in identity else {}
    same = {name: own.get(name, digest) == digest for name, digest in before.items()}
    return {**{name if same[name] else f"{name} (earlier)": digest for name, digest in before.items()}, **own}


def origin_of(identity: Mapping[str, Any], encoder: str) -> Origin | None:
    """Weights from which a training began: those of other trainings and, at first, of an encoder; None for random
    ones."""
    whats, licences, sources = [], [], []
    while "begun" in identity:
        identity = identity["begun"]
        name, steps, data = identity["method"], identity["steps"], ", ".join(data_of(identity))
        whats.append(f"weights of {name} after {steps} steps on {data}")
        licences.append(BEGUN_LICENCE)
        sources.append(f"oysterbench train {name}")
    if encoder:
        whats.append(f"EfficientNet-{encoder} trained on ImageNet")
        licences.append(ENCODER_LICENCE)
        sources.append(ENCODER_SOURCE)
    if not whats:
        return None
    return Origin(", begun from ".join(whats), "; ".join(dict.fromkeys(licences)), "; ".join(dict.fromkeys(sources)))


def plain(value: Any) -> Any:
    """Convert settings to values that JSON can hold."""
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    return [plain(part) for part in value] if isinstance(value, tuple | list) else value


def _numbers(weights: Any) -> list[int]:
    """Number of elements of each tensor in a state, which may hold several networks."""
    if isinstance(weights, torch.Tensor):
        return [weights.numel()]
    count: Callable[[Any], list[int]] = _numbers
    return [n for part in weights.values() for n in count(part)] if isinstance(weights, Mapping) else []
