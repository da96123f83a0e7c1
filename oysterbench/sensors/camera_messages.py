"""Messages of a camera: writing and reading its frames, their ground-truth layers, and its calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import SequenceError
from oysterbench.core.pictures import decode_picture
from oysterbench.core.ros import IMAGE, Message, decode, encode, header, image_bytes, make, stamp_of
from oysterbench.sensors.kind import topic

if TYPE_CHECKING:
    from oysterbench.sensors.camera import CameraCalibration

COLOUR = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
PNG_LEVEL = 1  # of 9: at level 6 a turbid frame is 5 % smaller but takes four times as long

LAYERS = {
    "depth": "16UC1",
    "class": "mono8",
    "instance": "16UC1",
    "normals": "32FC3",
    "clean": "32FC3",
    "direct": "32FC3",
    "forward_scatter": "32FC3",
    "backscatter": "32FC3",
    "snow": "32FC3",
    "visibility": "32FC1",
    "dynamic": "mono8",
    "flow": "32FC2",
    "transmittance": "32FC1",
}
"""Ground-truth layers of a camera and their encodings. Depth in mm along the optical axis, 0 = none (REP 118)."""

PIXELS = {"mono8": ("u1", 1), "16UC1": ("<u2", 1), "32FC1": ("<f4", 1), "32FC2": ("<f4", 2), "32FC3": ("<f4", 3)}
"""Encoding -> dtype of a number, and numbers per pixel."""


def optical_frame(camera: str) -> str:
    """Name of the frame of a camera's measurements: z forward, x right, y down (REP 103)."""
    return f"{camera}_optical_frame"


def camera_topics(camera: str, layers: tuple[str, ...] = tuple(LAYERS)) -> dict[str, str]:
    """Topic -> message type of everything that a camera sends: `image`, `camera_info` and the layers."""
    leaves = {"image": COLOUR, "camera_info": CAMERA_INFO} | dict.fromkeys(layers, IMAGE)
    return {topic(camera, leaf): kind for leaf, kind in leaves.items()}


def camera_info(stamp_ns: int, name: str, calibration: CameraCalibration) -> Message:
    """CameraInfo message with a camera's calibration for the frame with that stamp."""
    k = calibration.matrix
    message = make(
        CAMERA_INFO,
        header=header(stamp_ns, optical_frame(name)),
        height=calibration.height,
        width=calibration.width,
        distortion_model=calibration.distortion_model,
        d=coefficients(calibration),
        k=k.ravel(),
        r=np.eye(3).ravel(),
        p=np.column_stack([k, np.zeros(3)]).ravel(),
        binning_x=0,
        binning_y=0,
        roi=make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )
    return Message(f"/{name}/camera_info", stamp_ns, encode(message))


def coefficients(calibration: CameraCalibration) -> NDArray[np.float64]:
    """Distortion coefficients, padded with zeros to the number that the model has in CameraInfo."""
    n = 4 if calibration.distortion_model == "equidistant" else 5
    return np.pad(calibration.distortion, (0, n - len(calibration.distortion)))


def colour_message(
    stamp_ns: int, camera: str, pixels: NDArray[np.uint8], quality: int, image_format: str = "jpeg"
) -> Message:
    """Message with an image (H, W, 3) uint8 RGB as JPEG of the given quality, or as PNG, which is lossless."""
    suffix, settings = {
        "jpeg": (".jpg", [cv2.IMWRITE_JPEG_QUALITY, quality]),
        "png": (".png", [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL]),
    }[image_format]
    done, data = cv2.imencode(suffix, cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), settings)
    if not done:
        raise SequenceError(f"{camera}: the frame at {stamp_ns} could not be encoded as {image_format}")
    message = make(COLOUR, header=header(stamp_ns, optical_frame(camera)), format=image_format, data=data.ravel())
    return Message(f"/{camera}/image", stamp_ns, encode(message))


def read_colour(data: bytes) -> tuple[int, NDArray[Any]]:
    """Stamp and pixels (H, W, 3) uint8 RGB of a compressed image."""
    message = decode(data, COLOUR)
    pixels = decode_picture(message.data, cv2.IMREAD_COLOR_RGB)
    if pixels is None:
        raise SequenceError(f"the frame at {stamp_of(message.header)} is not a readable image")
    return stamp_of(message.header), pixels


def layer_message(stamp_ns: int, camera: str, layer: str, pixels: NDArray[Any]) -> Message:
    """Message with a layer's image, pixels in the units of `Image`; depth is rounded to mm."""
    if layer == "depth":
        pixels = np.rint(np.clip(pixels, 0.0, 65.535) * 1000.0)
    kind, _ = PIXELS[LAYERS[layer]]
    data = image_bytes(stamp_ns, optical_frame(camera), LAYERS[layer], np.asarray(pixels, dtype=kind))
    return Message(f"/{camera}/{layer}", stamp_ns, data)


def read_layer(data: bytes, layer: str) -> tuple[int, NDArray[Any]]:
    """Stamp and pixels of a layer, in the units of `Image`."""
    message = decode(data, IMAGE)
    kind, numbers = PIXELS[message.encoding]
    shape = (message.height, message.width) if numbers == 1 else (message.height, message.width, numbers)
    pixels = np.asarray(message.data).view(kind).reshape(shape)
    if layer == "depth":
        return stamp_of(message.header), pixels.astype(np.float32) / np.float32(1000.0)
    return stamp_of(message.header), pixels.astype(np.dtype(kind).newbyteorder("="))
