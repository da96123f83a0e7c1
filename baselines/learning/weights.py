"""Descriptions of the weights of these methods that are known before any training."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from oysterbench.hub.model import Training
from oysterbench.methods.weights import Weights


def _describe(name: str, path: Path) -> Training:
    from oysterbench_baselines.learning.card import describe  # torch is loaded only when needed

    return describe(name, path)


def _check(name: str, path: Path) -> None:
    from oysterbench_baselines.learning.card import read_weights

    read_weights(name, path)


def _weights(name: str, **known: object) -> Weights:
    return Weights(name=name, describe=partial(_describe, name), **{"check": partial(_check, name), **known})  # type: ignore[arg-type]


LIMITS = (
    "Counting oysters for decisions without a check against images of the same site that a person has labelled. Images "
    "above water, aquaria, other kinds of shells, and cameras unlike those of the training data were not looked at."
)
UNET = _weights(
    "unet",
    methods=("unet", "unet_instances"),
    train="unet --data seg-train",
    takes="about an hour on two cores once seg-train is rendered",
    option="unet[checkpoint=PATH]",
    summary="Segments oysters in underwater images, as pixels and as instances",
    limits=LIMITS,
)
UNET_SMALL = _weights(
    "unet_small",
    methods=("unet_small", "unet_small_instances"),
    train="unet_small --data seg-train",
    takes="about 20 to 30 minutes on one core once seg-train is rendered",
    option="unet_small[checkpoint=PATH]",
    summary="Segments oysters in underwater images: a small network without pretraining",
    limits=LIMITS,
)
STEERING = _weights(
    "steering",
    methods=("steering",),
    train="steering --data steer-train",
    takes="about 4 minutes on one core once steer-train is rendered; with rollouts, --dagger 1, about half an hour",
    option="steering[checkpoint=PATH]",
    summary="Steers a vehicle over a reef from its front camera, trained on an expert that knows where oysters are",
    limits="Driving a real vehicle without a guard that keeps it off the ground: it was never tried outside of "
    "rendered reefs.",
)
GTSAM_VI_LEARNED = _weights(
    "gtsam_vi_learned",
    methods=("gtsam_vi_learned",),
    train="gtsam_vi_learned --data slam-train",
    takes="about 5 minutes on one core once slam-train is rendered",
    option="gtsam_vi_learned[checkpoint=PATH]",
    summary="Predicts tracking errors over the image, for visual-inertial odometry",
    limits="Images above water: it was trained on rendered dives alone.",
)
MOVING = _weights(
    "moving",
    methods=("gtsam_vi[mask=moving]", "gtsam_vi_stereo[mask=moving]", "gtsam_full[mask=moving]"),
    train="moving --data slam-train --steps 1500",
    takes="about 6 minutes on one core once slam-train is rendered",
    option="mask=PATH",
    summary="Segments what moves in underwater images: fish, crabs, plants, a tether",
    limits="Finding animals: it is made to leave out too much rather than too little, and knows no kinds.",
)
CUT = _weights(
    "cut",
    methods=(),
    train="cut --source seg-closeup --target PATH --out cut",
    takes="about 10 minutes on one core, at the size small",
    option="oysterbench translate cut CHECKPOINT",
    summary="Translates rendered images of oysters to look like real ones",
    limits="Images that are shown as real ones. Labels may drift by some pixels: `oysterbench translate` says by how "
    "many.",
    check=lambda path: None,  # those of an unfinished training translate, too
)
