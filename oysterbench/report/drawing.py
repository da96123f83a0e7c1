"""A drawing that is kept as marks, and written as SVG or as PNG: the same figure in a page and in a document."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import OysterbenchError

INK, SOFT, PAPER = "#14202b", "#52606d", "#ffffff"
HALO = 1.6  # width around letters that have one
HERSHEY_PX = 22.0  # height of the vector font's capitals at a scale of 1
ASCII = {"\N{EN DASH}": "-", "\N{MINUS SIGN}": "-", "\N{GREATER-THAN OR EQUAL TO}": ">=", "\N{MIDDLE DOT}": "-"}


@dataclass
class Drawing:
    """Marks on a sheet of so many units; the origin is the upper left corner. Colours are #rrggbb."""

    width: float
    height: float
    title: str = ""
    marks: list[tuple[str, dict[str, Any]]] = field(default_factory=list)

    def rect(self, x: float, y: float, w: float, h: float, fill: str = "", stroke: str = "", thick: float = 1) -> None:
        """A rectangle."""
        self.polygon([(x, y), (x + w, y), (x + w, y + h), (x, y + h)], fill, stroke, thick)

    def polygon(
        self, points: Sequence[tuple[float, float]], fill: str = "", stroke: str = "", thick: float = 1
    ) -> None:
        """A closed outline."""
        self.marks.append(("polygon", {"points": list(points), "fill": fill, "stroke": stroke, "thick": thick}))

    def line(self, x0: float, y0: float, x1: float, y1: float, stroke: str = INK, thick: float = 1) -> None:
        """A line."""
        self.marks.append(("line", {"points": [(x0, y0), (x1, y1)], "stroke": stroke, "thick": thick}))

    def dot(self, x: float, y: float, r: float, fill: str, stroke: str = "") -> None:
        """A disc."""
        self.marks.append(("dot", {"x": x, "y": y, "r": r, "fill": fill, "stroke": stroke}))

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
        mark = {"x": x, "y": y, "text": text, "size": size, "anchor": anchor, "bold": bold, "fill": fill, "halo": halo}
        self.marks.append(("text", mark))

    def image(self, x: float, y: float, w: float, h: float, pixels: NDArray[np.uint8]) -> None:
        """A picture (H, W, 3) RGB."""
        self.marks.append(("image", {"x": x, "y": y, "w": w, "h": h, "pixels": pixels}))

    def svg(self) -> str:
        """As an SVG element."""
        inside = "".join(_SVG[kind](mark) for kind, mark in self.marks)
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width:g} {self.height:g}" role="img" '
            f'aria-label="{escape(self.title)}" style="display:block;width:100%;height:auto;background:{PAPER}" '
            f'font-family="system-ui, -apple-system, Segoe UI, Roboto, DejaVu Sans, sans-serif">'
            f"<title>{escape(self.title)}</title>{inside}</svg>"
        )

    def png(self, scale: float = 2.0) -> bytes:
        """As PNG, so many pixels to a unit."""
        sheet = np.full((round(self.height * scale), round(self.width * scale), 3), 255, dtype=np.uint8)
        for kind, mark in self.marks:
            _PNG[kind](sheet, mark, scale)
        return encoded(sheet)


def encoded(pixels: NDArray[np.uint8], suffix: str = ".png") -> bytes:
    """A picture (H, W, 3) RGB or (H, W, 4) RGBA as a file."""
    code = cv2.COLOR_RGBA2BGRA if pixels.shape[2] == 4 else cv2.COLOR_RGB2BGR
    done, data = cv2.imencode(suffix, cv2.cvtColor(pixels, code))
    if not done:
        raise OysterbenchError("a picture of the map could not be encoded")
    return data.tobytes()


def rgb(colour: str) -> tuple[int, int, int]:
    """Of #rrggbb."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def _svg_polygon(mark: dict[str, Any]) -> str:
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in mark["points"])
    stroke = f' stroke="{mark["stroke"]}" stroke-width="{mark["thick"]:g}"' if mark["stroke"] else ""
    return f'<polygon points="{points}" fill="{mark["fill"] or "none"}"{stroke}/>'


def _svg_line(mark: dict[str, Any]) -> str:
    (x0, y0), (x1, y1) = mark["points"]
    return (
        f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{mark["stroke"]}" '
        f'stroke-width="{mark["thick"]:g}"/>'
    )


def _svg_dot(mark: dict[str, Any]) -> str:
    stroke = f' stroke="{mark["stroke"]}" stroke-width="0.6"' if mark["stroke"] else ""
    return f'<circle cx="{mark["x"]:.1f}" cy="{mark["y"]:.1f}" r="{mark["r"]:g}" fill="{mark["fill"]}"{stroke}/>'


def _svg_text(mark: dict[str, Any]) -> str:
    weight = ' font-weight="600"' if mark["bold"] else ""
    halo = mark["halo"]
    around = f";paint-order:stroke;stroke:{halo};stroke-width:{2 * HALO}px;stroke-linejoin:round" if halo else ""
    return (
        f'<text x="{mark["x"]:.1f}" y="{mark["y"]:.1f}" font-size="{mark["size"]:g}" text-anchor="{mark["anchor"]}" '
        f'fill="{mark["fill"]}"{weight} style="font-size:{mark["size"]:g}px;fill:{mark["fill"]}{around}">'
        f"{escape(mark['text'])}</text>"
    )


def _svg_image(mark: dict[str, Any]) -> str:
    data = base64.b64encode(encoded(mark["pixels"], ".jpg")).decode()
    return (
        f'<image x="{mark["x"]:.1f}" y="{mark["y"]:.1f}" width="{mark["w"]:.1f}" height="{mark["h"]:.1f}" '
        f'preserveAspectRatio="none" href="data:image/jpeg;base64,{data}"/>'
    )


def _scaled(points: Sequence[tuple[float, float]], scale: float) -> NDArray[np.int32]:
    return np.rint(np.array(points) * scale).astype(np.int32)


def _png_polygon(sheet: Any, mark: dict[str, Any], scale: float) -> None:
    points = _scaled(mark["points"], scale)
    if mark["fill"]:
        cv2.fillPoly(sheet, [points], rgb(mark["fill"]), cv2.LINE_AA)
    if mark["stroke"]:
        cv2.polylines(sheet, [points], True, rgb(mark["stroke"]), max(1, round(mark["thick"] * scale)), cv2.LINE_AA)


def _png_line(sheet: Any, mark: dict[str, Any], scale: float) -> None:
    begin, end = _scaled(mark["points"], scale).tolist()
    cv2.line(sheet, begin, end, rgb(mark["stroke"]), max(1, round(mark["thick"] * scale)), cv2.LINE_AA)


def _png_dot(sheet: Any, mark: dict[str, Any], scale: float) -> None:
    # Sixteenths of a pixel: discs of a few pixels would else be of different sizes.
    centre = (round(mark["x"] * scale * 16), round(mark["y"] * scale * 16))
    radius = round(mark["r"] * scale * 16)
    if mark["stroke"]:
        cv2.circle(sheet, centre, radius + 16, rgb(mark["stroke"]), -1, cv2.LINE_AA, 4)
    cv2.circle(sheet, centre, radius, rgb(mark["fill"]), -1, cv2.LINE_AA, 4)


def _png_text(sheet: Any, mark: dict[str, Any], scale: float) -> None:
    """The vector font knows ASCII alone: a raised two is a small one, raised."""
    text = mark["text"]
    for sign, plain in ASCII.items():
        text = text.replace(sign, plain)
    font, size = cv2.FONT_HERSHEY_SIMPLEX, mark["size"] * scale * 0.74 / HERSHEY_PX
    thick = max(1, round(mark["size"] * scale / (11 if mark["bold"] else 17)))
    parts = [(part, k % 2 == 1) for k, part in enumerate(_raised(text)) if part]
    sizes = [size * (0.65 if up else 1.0) for _, up in parts]
    widths = [cv2.getTextSize(part, font, s, thick)[0][0] for (part, _), s in zip(parts, sizes, strict=True)]
    x = mark["x"] * scale - sum(widths) * {"start": 0.0, "middle": 0.5, "end": 1.0}[mark["anchor"]]
    for (part, up), s, width in zip(parts, sizes, widths, strict=True):
        y = mark["y"] * scale - (0.38 * mark["size"] * scale if up else 0.0)
        place = round(x), round(y)
        if mark["halo"]:
            wide = thick + round(2 * HALO * scale)
            cv2.putText(sheet, part, place, font, s, rgb(mark["halo"]), wide, cv2.LINE_AA)
        cv2.putText(sheet, part, place, font, s, rgb(mark["fill"]), thick, cv2.LINE_AA)
        x += width


def _raised(text: str) -> list[str]:
    """Text, raised, text, raised, ..."""
    parts: list[str] = []
    for part in text.split("\N{SUPERSCRIPT TWO}"):
        parts += [part, "2"]
    return parts[:-1]


def _png_image(sheet: Any, mark: dict[str, Any], scale: float) -> None:
    x, y, w, h = (round(mark[key] * scale) for key in "xywh")
    sheet[y : y + h, x : x + w] = cv2.resize(mark["pixels"], (w, h), interpolation=cv2.INTER_AREA)


_SVG = {"polygon": _svg_polygon, "line": _svg_line, "dot": _svg_dot, "text": _svg_text, "image": _svg_image}
_PNG = {"polygon": _png_polygon, "line": _png_line, "dot": _png_dot, "text": _png_text, "image": _png_image}
