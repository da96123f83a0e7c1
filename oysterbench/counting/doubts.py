"""Warnings that concern all counts of a set of images, as text for the terminal, the page and the summary."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from oysterbench.counting.measure import PictureCount

PLAUSIBLE_MM = (5.0, 400.0)
"""Plausible mean lengths of oysters, with a margin on both sides: 1122 from Virginia measured 24.9 to 172 mm. Outside,
the scale is probably in another unit."""

WHOLE = 0.9
"""Minimum share of a quadrat visible in its image for it to count as whole."""

UNITS = {
    "plain": "--mm-per-px takes millimetres per pixel",
    "altitude": "--altitude takes metres",
    "quadrat": "--quadrat takes metres, --corners pixels",
}
"""Kind of a scale -> its unit."""


def doubts(
    method: str,
    pictures: Sequence[PictureCount],
    length_mm: float,
    scale: str,
    copies: Sequence[tuple[str, str]] = (),
    quadrat_m2: float = math.nan,
    rendered: bool = False,
) -> Iterator[str]:
    """Yield a sentence for each warning. length_mm: mean of all oysters, NaN if unknown; scale: its kind, empty for
    none; copies: names of files, each with that of the file of which it is a copy; quadrat_m2: area of a whole quadrat,
    NaN if there are none; rendered: whether the method has learnt from rendered images alone, and nothing tells how far
    off it is on others."""
    if pictures and rendered:
        states = ", and take live ones for dead" if any(one.live or one.dead for one in pictures) else ""
        yield (
            f"{method} was trained on rendered reefs only: it may count several times as many oysters as there are "
            f"in real images{states}; train it further on labelled images of your own (`oysterbench train unet --help` "
            "says how)"
        )
    if copies:
        listed = ", ".join(f"{name} is {first}" for name, first in copies[:3]) + ", ..." * (len(copies) > 3)
        files = "file is a copy of another" if len(copies) == 1 else "files are copies of others"
        yield (
            f"{len(copies)} {files} and counted as often, which makes intervals too narrow: {listed}; remove the copies"
        )
    cut = sum(one.area_m2 is not None and one.area_m2 < WHOLE * quadrat_m2 for one in pictures)
    if cut:
        yield (
            f"{cut} of {len(pictures)} quadrats reach beyond their images, and only the part that is seen counts: "
            "were the corners marked in a resized copy?"
        )
    unit = f"is the scale in another unit ({UNITS.get(scale, '')})"
    low, high = PLAUSIBLE_MM
    if not math.isnan(length_mm) and not low <= length_mm <= high:
        merged = length_mm > high and any(one.parts for one in pictures)
        yield (
            f"the mean length is {length_mm:.{0 if length_mm >= 10 else 3}f} mm, where {low:g} to {high:g} mm are "
            f"expected of oysters: {unit}{', or do oysters touch, so that several are one part' if merged else ''}?"
        )
    sizes = {tuple(sorted((one.width, one.height))) for one in pictures}
    if scale == "plain" and len(sizes) > 1:
        some = ", ".join(f"{long} x {short}" for short, long in sorted(sizes)[:3]) + ", ..." * (len(sizes) > 3)
        yield (
            f"one --mm-per-px was taken for images of {len(sizes)} sizes ({some} px): "
            "is it the same in all of them? Else count each size by itself"
        )
    small = sum(one.small for one in pictures)
    if scale and small and not any(one.oysters for one in pictures):
        yield f"all {small} oysters are too small to count: {unit}?"
    if pictures and all(one.novelty is None for one in pictures):
        yield (
            f"{method} has no test of whether images are unlike its training data: it finds oysters in images of "
            "anything; look at the outlines before you trust the counts"
        )
