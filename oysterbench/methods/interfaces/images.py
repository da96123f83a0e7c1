"""Methods of the image tracks: a folder of images in, a prediction for each out.

The folder holds NAME.png for each image, and images.txt with the names in order. Predictions of a Python method are
stored as arrays, one .npz for each image; those of a program are kept as they are: masks, probabilities or classes in a
folder or an .npz, or COCO annotations (`annotations.open_predictions`, `annotations.read_coco`).
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError, SequenceError
from oysterbench.methods.images import DetectionMethod, Detections, Picture, Segmentation, SegmentationMethod
from oysterbench.methods.interfaces.interface import Interface, Predicted, RunSequence, Stopwatch

LIST = "images.txt"
FORM = "images"
PREDICTIONS = "predictions"
KINDS: dict[str, type[Segmentation | Detections]] = {"segmentation": Segmentation, "detections": Detections}
LIMIT_OF_PICTURE_S = 10.0

Prediction = Segmentation | Detections


class ImagesInterface(Interface):
    """Images in, a `Segmentation` or `Detections` for each out."""

    forms: ClassVar = {FORM: "a folder of images, NAME.png, and images.txt with their names in order"}
    own_form = FORM
    lasting = (FORM,)
    out = PREDICTIONS
    leaves = "masks or COCO annotations"

    def predict(self, method: Any, given: Path, folder: Path, watch: Stopwatch) -> Predicted:
        """Run the method on the images, which it receives one by one."""
        names = listed(given)
        pictures = (Picture(name, read_picture(given, name)) for name in names)
        (folder / PREDICTIONS).mkdir()
        for k, prediction in enumerate(predictions(method, pictures, given.name, len(names), watch)):
            _write(folder / PREDICTIONS / f"{k:06d}.npz", prediction)
        return Predicted(prediction={"arrays": True})

    def take(
        self, sequence: RunSequence, given: Path, folder: Path, form: str, options: Mapping[str, str]
    ) -> Predicted:
        """Give the output file the suffix that fits its content; the predictions are read only when they are scored."""
        place = folder / self.out
        if place.is_dir():
            return Predicted(prediction={"arrays": False, "place": place.name})
        with open(place, "rb") as file:
            suffix = ".npz" if file.read(2) == b"PK" else ".json"
        os.rename(place, place.with_suffix(suffix))
        return Predicted(prediction={"arrays": False, "place": f"{place.name}{suffix}"})


def write_pictures(pictures: Iterable[Picture], folder: Path) -> None:
    """Write a folder of images, losslessly. Raises SequenceError for a name that would lead out of the folder."""
    folder.mkdir(parents=True)
    names = []
    for picture in pictures:
        path = folder / f"{picture.name}.png"
        inside = folder in Path(os.path.normpath(path)).parents
        if not inside or not picture.name.isprintable():
            raise SequenceError(f"name of an image: expected one that can be a file's, got {picture.name!r}")
        path.parent.mkdir(parents=True, exist_ok=True)
        bgr = cv2.cvtColor(picture.pixels, cv2.COLOR_RGB2BGR)
        if not cv2.imwrite(str(path), bgr, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
            raise SequenceError(f"{path}: the image could not be written")
        names.append(picture.name)
    (folder / LIST).write_text("".join(f"{name}\n" for name in names), encoding="utf-8")


def listed(folder: Path) -> list[str]:
    """Read the names of the images of a folder, in order."""
    return (folder / LIST).read_text(encoding="utf-8").splitlines()


def read_picture(folder: Path, name: str) -> NDArray[np.uint8]:
    """Read an image of a folder, (H, W, 3) uint8 RGB."""
    pixels = cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_COLOR)
    if pixels is None:
        raise SequenceError(f"{folder / name}.png: cannot be read as an image")
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def predictions(
    method: SegmentationMethod | DetectionMethod, pictures: Iterable[Picture], where: str, count: int, watch: Stopwatch
) -> Iterator[Prediction]:
    """Yield a method's predictions for the `count` images of a sequence, in order.

    Raises MethodError where the method does not give exactly one prediction for each image, in order.
    """
    who = f"method {method.name!r} on {where}"
    waiting: list[str] = []
    done = 0

    def given() -> Iterator[Picture]:
        for picture in watch.leave_out(pictures):
            waiting.append(picture.name)
            yield picture

    found = iter(method.run(given()))
    while True:
        with watch:
            prediction = next(found, None)
        if prediction is None:
            break
        expected = waiting.pop(0) if waiting else None
        if expected is None or getattr(prediction, "name", None) != expected:
            raise MethodError(
                f"{who}: expected a prediction for {expected or 'nothing more'}, "
                f"got one for {getattr(prediction, 'name', prediction)!r:.80}"
            )
        if not isinstance(prediction, Prediction):
            raise MethodError(f"{who}: expected a Segmentation or Detections, got {type(prediction).__name__}")
        done += 1
        yield prediction
    if done < count:
        raise MethodError(f"{who}: expected {count} predictions, one for each image, got {done}")


def _write(path: Path, prediction: Prediction) -> None:
    (kind,) = [kind for kind, of in KINDS.items() if type(prediction) is of]
    fields = [field.name for field in dataclasses.fields(prediction) if field.name != "name"]
    arrays = {key: np.asarray(value) for key in fields if (value := getattr(prediction, key)) is not None}
    if wrong := [key for key, array in arrays.items() if array.dtype.kind not in "biuf"]:
        raise MethodError(f"{prediction.name}: {wrong[0]}: expected an array of numbers, got {arrays[wrong[0]].dtype}")
    np.savez_compressed(path, kind=np.array(kind), **arrays)  # type: ignore[arg-type]


def read_predictions(folder: Path, names: Sequence[str]) -> Iterator[Prediction]:
    """Read the predictions that a Python method left for the images of these names. Raises MethodError."""
    for k, name in enumerate(names):
        path = folder / PREDICTIONS / f"{k:06d}.npz"
        try:
            with np.load(path, allow_pickle=False) as held:
                arrays = {key: held[key] if held[key].ndim else held[key].item() for key in held.files}
            yield KINDS[str(arrays.pop("kind"))](name, **arrays)
        except Exception as error:  # numpy and zipfile raise many types, and the bytes may come from a stranger
            raise MethodError(f"{path}: no prediction can be read: {type(error).__name__}: {error}") from None


INTERFACE = ImagesInterface()
