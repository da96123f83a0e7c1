"""Predictions as one file per image, in a folder, or as the arrays of one .npz.

NAME.png   8 or 16 bits: a mask (0, and 1 or the greatest number), probabilities scaled to the greatest number, classes,
           or the numbers of single oysters
NAME.npy   (H, W) bool, integer or float: a mask, classes or probabilities from 0 to 1
NAME.npz   the same, one array
all.npz    an array per image, by its name

NAME is the image's name, which may contain folders.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from glob import escape
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from oysterbench.annotations.forms import JUDGED, Form, judged
from oysterbench.annotations.image import read_plane
from oysterbench.core.errors import LabelError
from oysterbench.core.pictures import LARGEST_IMAGE_PX
from oysterbench.core.places import is_hidden
from oysterbench.core.text import in_one_line
from oysterbench.evaluate.detection.instances import instance_numbers
from oysterbench.evaluate.segmentation import EstimateImage

SUFFIXES = (".png", ".npy", ".npz")
OTHERS = (".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
PALETTE = b"\x03"
"""Colour type of a PNG with a palette, at byte 25."""
PNG_MAGIC, PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"

MOST_BYTES = 8 * LARGEST_IMAGE_PX

T = TypeVar("T")


class MaskFiles:
    """Predictions by the name of their image, each read on access.

    form: meaning of the values. "auto": floating-point numbers are probabilities; integers of 0 and one other number,
    the same in all files, are masks; other integers are probabilities, as shares of the type's greatest number, or, if
    of 16 bits, small and in patches, the numbers of single oysters. What could be either is refused, as are 8-bit
    numbers in patches and masks of 0 and 1 among files of a few greater numbers: then the form must be given. Files of
    floating-point numbers or booleans change nothing in how the integers beside them are read.
    """

    def __init__(
        self,
        place: Path,
        readers: dict[str, Callable[[], NDArray[Any]]],
        form: Form,
        files: Mapping[str, Path] | None = None,
    ) -> None:
        self.place = place
        self._files = files or {}
        self.form = form
        self._readers = readers

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all images with a prediction."""
        return tuple(self._readers)

    def get(self, name: str) -> EstimateImage:
        """Read the prediction for an image. Raises LabelError naming its file."""
        values, where = self.plane(name), self.where(name)
        if values.dtype == bool:
            return EstimateImage(name, oyster=values)
        kind = self._kind_of(values)
        if kind == "classes":
            return EstimateImage(name, classes=self._classes(values, where))
        if kind == "instances":
            return EstimateImage(name, oyster=instance_numbers(values, where) > 0)
        if kind == "mask":
            return EstimateImage(name, oyster=as_mask(values, where))
        if np.issubdtype(values.dtype, np.floating):
            return EstimateImage(name, probability=values)
        return self._integers(name, values, where)

    @property
    def kind(self) -> Form:
        """Meaning of the values: `form`, or, if that is "auto", of the integers, judging by all of them; "auto" if they
        are masks of 0 and 1, or probabilities. Raises LabelError where it cannot be told (`forms.judged`)."""
        return self._judged[0]

    @property
    def notes(self) -> tuple[str, ...]:
        """What to tell about how the values are read. Raises LabelError as `kind`."""
        return self._judged[1]

    @cached_property
    def _judged(self) -> tuple[Form, tuple[str, ...]]:
        if self.form != "auto":
            return self.form, ()
        return judged((self.where(name), self.plane(name)) for name in self._readers)

    def _kind_of(self, values: NDArray[Any]) -> Form:
        """Meaning of one file's values: what all integers are judged to be says nothing of other types."""
        kind = self.kind
        return kind if self.form != "auto" or values.dtype in JUDGED else "auto"

    @property
    def numbered(self) -> bool:
        """Whether values, or the integers among them, are numbers of single oysters."""
        return self.kind == "instances"

    def numbers(self, name: str) -> NDArray[np.int32] | None:
        """Numbers (H, W) of the single oysters of an image; None if its file does not number them. Raises LabelError
        naming the file."""
        if not self.numbered or self._kind_of(values := self.plane(name)) != "instances":
            return None
        return np.asarray(instance_numbers(values, self.where(name)), dtype=np.int32)

    def where(self, name: str) -> str:
        """Path of an image's prediction, for messages; for an .npz of all images, with the array's name."""
        return str(self._files[name]) if name in self._files else f"{self.place}: {name}"

    def plane(self, name: str) -> NDArray[Any]:
        """Array (H, W) stored for an image, bool, integer or float. Raises LabelError naming its file."""
        values = np.asarray(self._readers[name]())
        where = self.where(name)
        if values.ndim == 3 and 1 in (values.shape[0], values.shape[-1]):
            values = values.squeeze()
        if values.ndim != 2:
            raise LabelError(f"{where}: expected an array (H, W), got one of shape {values.shape}")
        if values.dtype.kind not in "biuf":
            raise LabelError(f"{where}: expected numbers or booleans, got {values.dtype}")
        return values

    def _integers(self, name: str, values: NDArray[Any], where: str) -> EstimateImage:
        """Interpret integers whose meaning must be guessed, or that are declared to be probabilities."""
        greatest, most = int(values.max(initial=0)), np.iinfo(values.dtype).max
        if int(values.min(initial=0)) < 0 or values.dtype not in (np.uint8, np.uint16):
            raise LabelError(
                f"{where}: expected unsigned integers of 8 or 16 bits, got {values.dtype}; store a mask as bool, "
                "probabilities as float32, numbers of oysters as uint16; or say what they are: --estimate-kind mask, "
                "instances or classes (of a map --masks-kind)"
            )
        if self.kind == "auto" and greatest == 1:
            return EstimateImage(name, probability=values.astype(np.float32))
        return EstimateImage(name, probability=values.astype(np.float32) / np.float32(most))

    def _classes(self, values: NDArray[Any], where: str) -> NDArray[np.uint8]:
        if not np.issubdtype(values.dtype, np.integer) or values.min(initial=0) < 0 or values.max(initial=0) > 255:
            raise LabelError(f"{where}: expected class numbers from 0 to 255, got {values.dtype}")
        return values.astype(np.uint8)


ESTIMATE_KINDS = "for probabilities, classes or numbers of oysters say so (--estimate-kind; of a map --masks-kind)"


def as_mask(values: NDArray[Any], where: str, advice: str = ESTIMATE_KINDS) -> NDArray[np.bool_]:
    """Convert a plane of 0 and one other number, which marks oysters, to a mask. Raises LabelError, which ends with the
    advice, for more numbers."""
    if values.dtype == bool:
        return values
    greatest = values.max(initial=0)
    if not ((values == 0) | (values == greatest)).all():
        found = [f"{number:g}" for number in np.unique(values)[:6]]
        raise LabelError(f"{where}: expected a mask of 0 and one other number, got {', '.join(found)}...; {advice}")
    return values > 0


def open_predictions(place: Path, form: Form = "auto") -> MaskFiles:
    """Open the predictions in a folder or an .npz file. Raises LabelError if there are none."""
    if place.is_file() and place.suffix == ".npz":
        return MaskFiles(place, _arrays(place), form)
    if not place.is_dir():
        raise LabelError(
            f"{place}: expected a folder with a .png, .npy or .npz per image, an .npz of all, or COCO annotations "
            f"(.json), got {'another kind of file' if place.exists() else 'nothing of that name'}"
        )
    files: dict[str, Path] = {}
    shown = (path for path in place.rglob("*") if path.suffix.lower() in SUFFIXES and not is_hidden(path, place))
    for path in sorted(shown):
        name = path.relative_to(place).with_suffix("").as_posix()
        if name in files:
            raise LabelError(f"{place}: two files predict {name}; expected one of {', '.join(SUFFIXES)}")
        files[name] = path
    if not files:
        others = sorted({path.suffix for path in place.rglob("*") if path.suffix.lower() in OTHERS})
        got = f"{', '.join(others)} files; save masks as .png, since JPEG changes their values" if others else "none"
        raise LabelError(f"{place}: expected a .png, .npy or .npz per image, got {got}")
    return MaskFiles(place, {name: _reader(path) for name, path in files.items()}, form, files)


def _reader(path: Path) -> Callable[[], NDArray[Any]]:
    if path.suffix.lower() == ".png":
        return lambda: read_png(path)
    if path.suffix.lower() == ".npy":
        return lambda: _load(path, np.ndarray)
    return lambda: _single(path)


def read_png(path: Path) -> NDArray[Any]:
    """Read a PNG as (H, W) uint8 or uint16. Raises LabelError naming the file, also if its end is missing: the decoder
    would silently fill in the rest."""
    try:
        with open(path, "rb") as file:
            head = file.read(26)
            file.seek(max(0, path.stat().st_size - len(PNG_END)))
            whole = file.read() == PNG_END
    except OSError as error:
        raise LabelError(f"{path}: cannot be read: {error.strerror or error}") from None
    if head and not head.startswith(PNG_MAGIC):
        raise LabelError(f"{path}: not a PNG file")
    if not whole:
        raise LabelError(f"{path}: incomplete PNG file: its end is missing ({path.stat().st_size} bytes)")
    width, height = int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")
    if width * height > LARGEST_IMAGE_PX:
        raise LabelError(f"{path}: {width} x {height} pixels: larger than any image here")
    try:
        return read_plane(path)
    except LabelError:
        if head[25:] != PALETTE:
            raise
        raise LabelError(
            f"{path}: expected one channel, got a palette, whose colours are read in place of its numbers; save the "
            "numbers as a grey PNG (with Pillow: Image.fromarray(numpy.array(Image.open(FILE))))"
        ) from None


@contextmanager
def _reading(what: str) -> Iterator[None]:
    """Turn whatever numpy and zipfile raise for untrusted bytes into a LabelError of one line."""
    try:
        yield
    except LabelError:
        raise
    except Exception as error:
        raise LabelError(f"{what} cannot be read as numpy arrays: {in_one_line(error)}") from None


def _load(path: Path, kind: type[T]) -> T:
    with _reading(str(path)):
        found = np.load(path, allow_pickle=False)
    if not isinstance(found, kind):
        raise LabelError(f"{path}: expected one array in an .npy, or several in an .npz")
    return found


def _arrays(path: Path) -> dict[str, Callable[[], NDArray[Any]]]:
    archive = _load(path, NpzFile)
    if not archive.files:
        raise LabelError(f"{path}: expected an array per image, got none")
    return {key: _member(archive, key, path) for key in sorted(archive.files)}


def _member(archive: Any, key: str, path: Path) -> Callable[[], NDArray[Any]]:
    def read() -> NDArray[Any]:
        with _reading(f"{path}: array {key}"):
            size = sum(entry.file_size for entry in archive.zip.infolist() if entry.filename in (key, f"{key}.npy"))
            if size > MOST_BYTES:
                raise LabelError(f"{path}: array {key}: expected at most {MOST_BYTES >> 20} MiB, got {size >> 20} MiB")
            return np.asarray(archive[key])

    return read


def _single(path: Path) -> NDArray[Any]:
    arrays = _arrays(path)
    if len(arrays) != 1:
        raise LabelError(f"{path}: expected one array, got {', '.join(arrays)}")
    (read,) = arrays.values()
    return read()


def check_names(truth: Iterable[str], predicted: Iterable[str], place: Path, unscored: Iterable[str] = ()) -> None:
    """Refuse predictions that are not of exactly the truth's images: missing ones would otherwise be silently left
    out. unscored: further images of the truth, which may have predictions."""
    wanted = set(truth)
    given = set(predicted) - (set(unscored) - wanted)
    for missing, text in ((wanted - given, "no prediction for"), (given - wanted, "no image of the truth is named")):
        if missing:
            names = sorted(missing)
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            # Such as a JPEG, whose compression changes the values of a mask.
            other = (
                next((path.name for path in sorted(place.glob(f"{escape(names[0])}.*"))), "") if place.is_dir() else ""
            )
            form = f" ({other} is there, which is no {', '.join(SUFFIXES)})" if other and names[0] in wanted else ""
            got = f", got {min(given - wanted)}" if given - wanted and names[0] in wanted else ""
            raise LabelError(
                f"{place}: {text} {', '.join(names[:3])}{more}{form}; expected one prediction for each of "
                f"{len(wanted)} images, named as in the ground truth, e.g. {min(wanted, default='NAME')}{got}"
            )
