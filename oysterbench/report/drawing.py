"""A drawing on a sheet of so many units, by matplotlib: the same figure as SVG in a page and as PNG in a document."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from html import escape
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from oysterbench.core.errors import OysterbenchError

INK, SOFT, PAPER = "#14202b", "#52606d", "#ffffff"
HALO = 1.6  # width around letters that have one
POINTS_PER_INCH = 72.0  # so that a unit of the sheet is a point, which lengths of fonts and lines are given in
SVG_SCALE = 2.0  # pixels of pictures in an SVG to a unit


class Drawing:
    """Marks on a sheet, drawn over each other in their order; the origin is the upper left corner; y grows downwards.

    Colours are #rrggbb, lengths units of the sheet.
    """

    def __init__(self, width: float, height: float, title: str = "") -> None:
        from matplotlib.figure import Figure

        self.width, self.height, self.title = width, height, title
        self._figure = Figure((width / POINTS_PER_INCH, height / POINTS_PER_INCH), POINTS_PER_INCH, facecolor=PAPER)
        self._axes = self._figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._axes.set_axis_off()
        self._axes.set(xlim=(0.0, width), ylim=(height, 0.0), autoscale_on=False)
        self._marks = 0

    def _look(self) -> dict[str, Any]:
        """What every mark has: nothing cuts it, and it lies above those before it."""
        self._marks += 1
        return {"clip_on": False, "zorder": self._marks}

    def rect(self, x: float, y: float, w: float, h: float, fill: str = "", stroke: str = "", thick: float = 1) -> None:
        """A rectangle."""
        self.polygon([(x, y), (x + w, y), (x + w, y + h), (x, y + h)], fill, stroke, thick)

    def polygon(
        self, points: Sequence[tuple[float, float]], fill: str = "", stroke: str = "", thick: float = 1
    ) -> None:
        """A closed outline."""
        from matplotlib.patches import Polygon

        edge = stroke or "none"
        self._axes.add_patch(Polygon(points, facecolor=fill or "none", edgecolor=edge, linewidth=thick, **self._look()))

    def line(self, x0: float, y0: float, x1: float, y1: float, stroke: str = INK, thick: float = 1) -> None:
        """A line."""
        self.path([(x0, y0), (x1, y1)], stroke, thick)

    def path(self, points: ArrayLike, stroke: str = INK, thick: float = 1) -> None:
        """A line through points (N, 2)."""
        self._axes.plot(*np.asarray(points, dtype=float).T, color=stroke, linewidth=thick, **self._look())

    def dot(self, x: float, y: float, r: float, fill: str, stroke: str = "") -> None:
        """A disc."""
        self.dots([(x, y)], r, fill, stroke)

    def dots(self, points: ArrayLike, r: float, fill: str | Sequence[str], stroke: str = "") -> None:
        """Discs around points (N, 2), all of one colour or each of its own."""
        x, y = np.asarray(points, dtype=float).reshape(-1, 2).T
        edge: dict[str, Any] = {"edgecolors": stroke or "none", "linewidths": 0.6 if stroke else 0.0}
        self._axes.scatter(x, y, s=(2 * r) ** 2, c=fill, **edge, **self._look())

    def text(
        self,
        x: float,
        y: float,
        text: str,
        size: float = 14,
        anchor: str = "start",
        bold: bool = False,
        fill: str = INK,
        halo: str = "",
    ) -> None:
        """A line of text on its base line; anchor: start, middle or end; halo: colour around its letters."""
        from matplotlib.patheffects import withStroke

        side = {"start": "left", "middle": "center", "end": "right"}[anchor]
        weight = "bold" if bold else "normal"
        effects = [withStroke(linewidth=2 * HALO, foreground=halo)] if halo else None
        plain = text.replace("$", r"\$")  # no mathematics in names
        about: dict[str, Any] = {"ha": side, "va": "baseline", "weight": weight, "color": fill, "path_effects": effects}
        # The sheet is measured for letters narrower than those of matplotlib's own font.
        self._axes.text(x, y, plain, fontsize=0.9 * size, **about, **self._look())

    def image(self, x: float, y: float, w: float, h: float, pixels: NDArray[np.uint8]) -> None:
        """A picture (H, W, 3) RGB."""
        self._axes.imshow(pixels, extent=(x, x + w, y + h, y), aspect="auto", **self._look())

    def svg(self) -> str:
        """As an SVG element, the same bytes for the same marks."""
        import matplotlib

        # Letters as paths look the same everywhere; the salt keeps names of marks apart from those of other figures.
        with matplotlib.rc_context({"svg.hashsalt": self.title}):
            text = self._saved("svg", SVG_SCALE, {"Date": None}).decode()
        root = (
            f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
            f'viewBox="0 0 {self.width:g} {self.height:g}" role="img" aria-label="{escape(self.title)}" '
            f'style="display:block;width:100%;height:auto;stroke-linejoin:round"><title>{escape(self.title)}</title>'
        )
        text = re.sub(r"<metadata>.*?</metadata>|<style[^>]*>.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
        text = re.sub(r"data:image/png;base64,([\w+/=\s]+)", _jpeg, text)
        return root + re.split(r"<svg [^>]*>", text, maxsplit=1)[1].strip()

    def png(self, scale: float = 2.0) -> bytes:
        """As PNG, so many pixels to a unit."""
        return self._saved("png", scale, {"Software": None})

    def _saved(self, form: str, scale: float, metadata: dict[str, Any]) -> bytes:
        file = io.BytesIO()
        self._figure.savefig(file, format=form, dpi=POINTS_PER_INCH * scale, metadata=metadata)
        return file.getvalue()


def _jpeg(found: re.Match[str]) -> str:
    """A picture within an SVG as JPEG, which is a tenth of the size."""
    data = np.frombuffer(base64.b64decode(found[1]), dtype=np.uint8)
    done, made = cv2.imencode(".jpg", np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR)), [cv2.IMWRITE_JPEG_QUALITY, 90])
    if not done:
        raise OysterbenchError("a picture of a figure could not be encoded")
    return f"data:image/jpeg;base64,{base64.b64encode(made.tobytes()).decode()}"


def encoded(pixels: NDArray[np.uint8]) -> bytes:
    """A picture (H, W, 3) RGB or (H, W, 4) RGBA as PNG."""
    code = cv2.COLOR_RGBA2BGRA if pixels.shape[2] == 4 else cv2.COLOR_RGB2BGR
    done, data = cv2.imencode(".png", cv2.cvtColor(pixels, code))
    if not done:
        raise OysterbenchError("a picture of the map could not be encoded")
    return data.tobytes()


def rgb(colour: str) -> tuple[int, int, int]:
    """Of #rrggbb."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
