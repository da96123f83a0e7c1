"""Methods of images for the tests: what is light is an oyster, and ones that do not do as agreed."""

from __future__ import annotations

import cv2
import numpy as np

from oysterbench.methods.images import Detections, Picture, Segmentation


def light(image):
    return Segmentation(image.name, oyster=image.pixels[..., 0] > 120)


class Light:
    """Finds what `make_clip` painted."""

    name, track = "light", "segmentation"

    def run(self, images):
        for image in images:
            assert type(image) is Picture  # a name and pixels: nothing that leads to the truth
            yield self.predict(image)

    def predict(self, image):
        return light(image)


class Raises(Light):
    name = "raises"

    def predict(self, image):
        raise ValueError("no idea")


class Another(Light):
    name = "another"

    def predict(self, image):
        return Segmentation("x", oyster=image.pixels[..., 0] > 9)


class Small(Light):
    name = "small"

    def predict(self, image):
        return Segmentation(image.name, oyster=np.zeros((2, 2), bool))


class Thing(Light):
    name = "thing"

    def predict(self, image):
        return image


class Lazy(Light):
    name = "lazy"

    def run(self, images):
        yield light(next(iter(images)))


class Numbered(Light):
    name, track = "numbered", "detection"

    def predict(self, image):
        numbers = cv2.connectedComponents((image.pixels[..., 0] > 120).astype(np.uint8))[1]
        return Detections(image.name, np.full(int(numbers.max()), 0.9), numbers=numbers)


class Boxed(Numbered):
    name = "boxed"

    def predict(self, image):
        found = super().predict(image).numbers
        boxes = [
            [*(float(v) for v in cv2.boundingRect((found == k).astype(np.uint8)))] for k in range(1, found.max() + 1)
        ]
        return Detections(image.name, np.full(len(boxes), 0.9), boxes=np.array(boxes).reshape(-1, 4))
