"""What the integers of masks mean, judged by all files of integers: masks, probabilities or numbers of oysters."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError
from oysterbench.core.names import listed

Form = Literal["auto", "instances", "mask", "probability", "classes"]
FORMS: tuple[str, ...] = get_args(Form)

JUDGED = (np.uint8, np.uint16)
"""Types whose meaning is judged: floating-point numbers and booleans say what they are, other integers are refused."""

NUMBERS = 0.01
"""Share of the greatest 16-bit number up to which values may be numbers of oysters: a probability map without any value
above 1 % would be meaningless."""
UNIFORM = 0.8
"""Minimum share of the numbered pixels with the same value as their right neighbour: numbers lie in patches,
probabilities do not."""
FAINT = 10
"""Greatest 8-bit value up to which values are no probabilities: none would be above 4 %."""
FEW = 2
"""Number of values other than 0 up to which a map may have levels rather than numbers: unsure and sure."""

MANY = 20
"""Number of values other than 0 in one map from which on it is one of probabilities, unless they lie in patches."""

PATCHES = 2.5
"""Maximum number of connected parts per number. True oysters have up to 1.7, as others hide parts of them; blocks of an
enlarged probability map have 5 and more where there are many."""
JUMPS = 0.2
"""Minimum share of the borders between patches where other values lie in between: probabilities change by degrees."""


def judged(planes: Iterable[tuple[str, NDArray[Any]]]) -> tuple[Form, tuple[str, ...]]:
    """Judge what the integers of files mean, given as name and plane (H, W); other planes do not enter. Returns the
    form, and notes on it.

    The form is "auto" if they are masks of 0 and 1, or probabilities. Raises LabelError naming a file where they could
    be numbers of oysters or of classes in a form in which integers are probabilities, or a mask of 0 and 1 among
    greater values.
    """
    values, kinds = set[int](), set[np.dtype[Any]]()
    zero_one: dict[np.dtype[Any], list[str]] = {}
    fullest, most_values, greatest = ("", np.zeros((1, 1), np.uint8)), -1, ("", np.zeros((1, 1), np.uint16))
    for name, plane in planes:
        if plane.dtype not in JUDGED:
            continue
        own = np.flatnonzero(np.bincount(plane.ravel()))
        values.update(own.tolist())
        kinds.add(plane.dtype)
        if plane.max(initial=0) == 1:
            zero_one.setdefault(plane.dtype, []).append(name)
        if len(own) > most_values:
            fullest, most_values = (name, plane), len(own)
        if plane.max(initial=0) > greatest[1].max(initial=0):
            greatest = name, plane
    numbers = sorted(values - {0})
    if not numbers or numbers == [1]:
        return "auto", ()
    limit = np.iinfo(greatest[1].dtype).max
    if len(numbers) == 1 and 0 in values:
        return ("auto" if numbers == [limit] and len(kinds) == 1 else "mask"), ()
    if kinds == {np.dtype(np.uint16)} and numbers[-1] <= NUMBERS * limit and _mostly_uniform(greatest[1]):
        return "instances", ()
    faint = kinds == {np.dtype(np.uint8)} and numbers[-1] <= FAINT
    if faint or (len(numbers) > FEW and in_patches(fullest[1])):
        name, plane = greatest if faint else fullest
        raise _ambiguous(name, plane, faint)
    if _shades(fullest[1]) >= MANY:
        return "probability", tuple(
            f"read as probabilities of 0 and 1/{np.iinfo(kind).max}, as other files have many values: "
            f"{listed(names, 3)}"
            for kind, names in zero_one.items()
        )
    if zero_one:
        (first, *_), *_ = zero_one.values()
        raise LabelError(
            f"{first} has only 0 and 1, like a mask, and {greatest[0]} greater values, like a probability map "
            f"with {limit} for 1: say which they are (--estimate-kind mask or probability, of a map --masks-kind), or "
            "send them as floating-point numbers"
        )
    return "auto", ()


def _ambiguous(name: str, plane: NDArray[Any], faint: bool) -> LabelError:
    """Error on a file whose values could be numbers. faint: or probabilities, none of which in any file is greater."""
    limit, top = np.iinfo(plane.dtype).max, plane.max()
    look = "look like numbers of oysters or of classes"
    if faint:
        look = (
            "could be numbers of oysters or classes, or probabilities of which none in any file is above "
            f"{top / limit:.1%}"
        )
    return LabelError(
        f"{name}: expected a mask of 0 and one other value, or probabilities, where {limit} is 1, got {_shades(plane)} "
        f"values up to {top}, which {look}; number oysters from 1 on in 16 bits, store probabilities as "
        "floating-point numbers; or say what they are: --estimate-kind instances, probability or classes (of a map "
        "--masks-kind)"
    )


def _shades(plane: NDArray[Any]) -> int:
    """Number of values other than 0."""
    return len(np.unique(plane[plane > 0]))


def in_patches(plane: NDArray[Any]) -> bool:
    """Whether each value other than 0 of a plane (H, W) lies in one patch, or few, next to any other values."""
    from scipy.ndimage import find_objects, label

    values, ranks = np.unique(plane, return_inverse=True)
    ranks = ranks.reshape(plane.shape).astype(np.int32) + (values[0] > 0)
    left, right = ranks[:, :-1], ranks[:, 1:]
    same, count = left == right, int(ranks.max()) + 1
    pixels = np.bincount(left.ravel(), minlength=count)[1:]
    uniform = np.bincount(left[same], minlength=count)[1:] / np.maximum(pixels, 1)
    steps = np.abs(left - right)[~same]
    # Edges of a sharp probability map have many values, each of single pixels; levels of a smooth one are nested.
    if np.median(uniform) <= 0.5 or not steps.size or (steps > 1).mean() < JUMPS:
        return False
    places = enumerate(find_objects(ranks), start=1)
    parts = sum(label(ranks[place] == number, np.ones((3, 3)))[1] for number, place in places if place is not None)
    return bool(parts <= PATCHES * (count - 1))


def _mostly_uniform(plane: NDArray[Any]) -> bool:
    left, right = plane[:, :-1], plane[:, 1:]
    return bool((left == right)[left > 0].mean() > UNIFORM) if left.any() else False
