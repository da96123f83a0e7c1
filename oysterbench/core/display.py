"""Notebook display: cards of facts, tables and images, as self-contained HTML."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from oysterbench.core.html import render

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

PICTURE_PX = 320
"""Maximum width of an image on a card, px."""
GOLDEN = 0.61803398875
"""Step around the circle of hues such that each hue lies far from all earlier ones."""
FAINT = 0.45
"""Weight of the colour that marks an oyster in its image."""
MARK = (255, 140, 0)
"""RGB of that colour: orange, which neither water nor bottom has."""


@dataclass(frozen=True)
class CardTable:
    """A table on a card: headings, and rows of printable values."""

    headings: Sequence[str]
    rows: Sequence[Sequence[object]]


@dataclass(frozen=True)
class CardPicture:
    """An image on a card, encoded (base64), with its caption."""

    caption: str
    data: str
    media: str = "image/jpeg"


def card(
    title: str,
    lead: str = "",
    tables: Iterable[CardTable] = (),
    pictures: Iterable[CardPicture] = (),
    notes: Iterable[str] = (),
) -> str:
    """Render a card as HTML; every text in it is escaped."""
    parts = {"tables": list(tables), "pictures": list(pictures), "notes": list(notes)}
    return render("notebook.html", {"title": title, "lead": lead, **parts})


def picture(pixels: NDArray[Any], caption: str, width: int = PICTURE_PX) -> CardPicture:
    """Encode an image or layer (H, W, ...), coloured by `shown` and scaled down to at most `width` px."""
    import cv2

    colours: NDArray[Any] = shown(pixels)
    if colours.shape[1] > width:
        height = max(1, round(colours.shape[0] * width / colours.shape[1]))
        colours = cv2.resize(colours, (width, height), interpolation=cv2.INTER_AREA)
    return CardPicture(caption, base64.b64encode(_encoded(colours, ".jpg")).decode())


def png(pixels: NDArray[Any]) -> bytes:
    """PNG bytes of an image or layer, coloured by `shown`."""
    return _encoded(shown(pixels), ".png")


def shown(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """Colour an image or layer of any kind: (H, W, 3) uint8 RGB.

    RGB images stay as they are; instance and class numbers (H, W) get a colour each, 0 is black; measures (H, W) go
    from dark to light between their 2nd and 98th percentiles, by their logarithm if all are positive, and missing ones
    (0, NaN) are black; three channels become RGB, scaled from -1 to 1, or from 0 to the maximum if none is negative;
    two channels are shown by their norm.
    """
    import numpy as np

    if pixels.dtype == np.uint8 and pixels.ndim == 3:
        return pixels
    if pixels.ndim == 3 and pixels.shape[2] == 3:
        low = -1.0 if np.nanmin(pixels, initial=0.0) < 0 else 0.0
        high = max(float(np.nanmax(pixels, initial=1e-9)), 1e-9) if low == 0.0 else 1.0
        return np.asarray(255 * np.clip((np.nan_to_num(pixels, nan=low) - low) / (high - low), 0, 1), dtype=np.uint8)
    if pixels.ndim == 3:
        return _graded(np.linalg.norm(pixels, axis=2))
    return _numbered(pixels) if pixels.dtype.kind in "biu" else _graded(pixels)


def marked(pixels: NDArray[np.uint8], where: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Tint the pixels of a mask (H, W) in an image (H, W, 3)."""
    import numpy as np

    found = pixels.astype(np.float32)
    found[where] = (1 - FAINT) * found[where] + FAINT * np.array(MARK, dtype=np.float32)
    return found.astype(np.uint8)


def _numbered(values: NDArray[Any]) -> NDArray[np.uint8]:
    import cv2
    import numpy as np

    hue = (values.astype(np.float64) * GOLDEN) % 1.0
    hsv = np.stack([180 * hue, np.full(hue.shape, 160), np.full(hue.shape, 230)], axis=-1).astype(np.uint8)
    colours = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)
    colours[values == 0] = 0
    return np.asarray(colours, dtype=np.uint8)


def _graded(values: NDArray[Any]) -> NDArray[np.uint8]:
    import cv2
    import numpy as np

    known = np.isfinite(values) & (values != 0)
    if not known.any():
        return np.zeros((*values.shape, 3), dtype=np.uint8)
    if (values[known] > 0).all():  # depths: by their logarithm, near ones differ as visibly as far ones
        values = np.log(np.where(known, values, 1.0))
    low, high = np.percentile(values[known], (2, 98))
    share = np.clip((np.where(known, values, low) - low) / max(high - low, 1e-12), 0, 1)
    colours = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1].copy()
    colours[~known] = 0
    return np.asarray(colours, dtype=np.uint8)


def _encoded(colours: NDArray[np.uint8], suffix: str) -> bytes:
    import cv2

    _, data = cv2.imencode(suffix, cv2.cvtColor(colours, cv2.COLOR_RGB2BGR))
    return bytes(data.tobytes())
