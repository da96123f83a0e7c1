"""Matplotlib figures: the same figure as SVG for a page and as PNG for a document."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import OysterbenchError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, SOFT, PALE = "#14202b", "#52606d", "#e3e7eb"
DPI = 144.0  # of PNGs, and of images within an SVG
POINTS_PER_INCH = 72.0
STYLE: dict[str, Any] = {
    "text.parse_math": False,  # names may contain a dollar sign
    "text.color": INK,
    "axes.axisbelow": True,
    "axes.edgecolor": SOFT,
    "axes.labelcolor": SOFT,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "font.size": 11.0,
    "axes.titlesize": 12.0,
    "figure.constrained_layout.h_pad": 0.12,
    "figure.constrained_layout.w_pad": 0.12,
    "figure.titlesize": 17.0,
    "figure.titleweight": "bold",
    "grid.color": PALE,
    "legend.frameon": False,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
}


@contextmanager
def figure_style() -> Iterator[None]:
    """Context in which figures are made: the common style, whatever the user's own settings are."""
    from matplotlib import style

    with style.context(STYLE, after_reset=True):
        yield


def new_figure(title: str, width: float, height: float) -> Figure:
    """Make an empty figure, size in inches, whose parts are laid out without overlap."""
    from matplotlib.figure import Figure

    figure = Figure((width, height), layout="constrained")
    figure.suptitle(title, x=0.01, ha="left")
    return figure


def add_note(figure: Figure, *lines: str) -> None:
    """Add lines of text at the foot of a figure."""
    figure.supxlabel("\n".join(lines), x=0.01, ha="left", color=SOFT, size=10.5)


def add_scale_bar(axes: Axes, width_m: float) -> None:
    """Add a scale bar of a round length, at most 0.35 of the width that the axes show."""
    from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

    steps = [factor * 10.0**power for power in range(-1, 4) for factor in (1, 2, 5)]
    metres = max((step for step in steps if step <= 0.35 * width_m), default=steps[0])
    axes.add_artist(
        AnchoredSizeBar(axes.transData, metres, f"{metres:g} m", "lower left", size_vertical=0.01 * width_m, color=INK)
    )


def svg_of(figure: Figure) -> str:
    """Render a figure as an SVG element: the same bytes for the same figure."""
    title = escape(figure.get_suptitle())
    # Letters drawn as paths look the same everywhere; the salt keeps ids distinct from those of other figures.
    text = _saved(figure, "svg", {"Date": None}, **{"svg.hashsalt": title}).decode()
    width, height = figure.get_size_inches() * POINTS_PER_INCH
    root = (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{title}" '
        f'style="display:block;width:100%;height:auto;stroke-linejoin:round"><title>{title}</title>'
    )
    text = re.sub(r"<metadata>.*?</metadata>|<style[^>]*>.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"data:image/png;base64,([\w+/=\s]+)", _jpeg, text)
    return root + re.split(r"<svg [^>]*>", text, maxsplit=1)[1].strip()


def png_of(figure: Figure) -> bytes:
    """Render a figure as PNG."""
    return _saved(figure, "png", {"Software": None})


def _saved(figure: Figure, form: str, metadata: dict[str, Any], **settings: str) -> bytes:
    import matplotlib

    file = io.BytesIO()
    with figure_style(), matplotlib.rc_context(dict(settings)):  # type: ignore[arg-type]
        if figure.get_layout_engine() is not None:  # each pass moves the parts a little: settle them for all formats
            figure.draw_without_rendering()
            figure.draw_without_rendering()
            figure.set_layout_engine(None)
        figure.savefig(file, format=form, dpi=DPI, metadata=metadata)
    return file.getvalue()


def _jpeg(found: re.Match[str]) -> str:
    """Re-encode an image within an SVG as JPEG, a tenth of the size."""
    data = np.frombuffer(base64.b64decode(found[1]), dtype=np.uint8)
    done, made = cv2.imencode(".jpg", np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR)), [cv2.IMWRITE_JPEG_QUALITY, 90])
    if not done:
        raise OysterbenchError("an image of a figure could not be encoded")
    return f"data:image/jpeg;base64,{base64.b64encode(made.tobytes()).decode()}"


def encoded(pixels: NDArray[np.uint8]) -> bytes:
    """Encode an image (H, W, 3) RGB or (H, W, 4) RGBA as PNG."""
    code = cv2.COLOR_RGBA2BGRA if pixels.shape[2] == 4 else cv2.COLOR_RGB2BGR
    done, data = cv2.imencode(".png", cv2.cvtColor(pixels, code))
    if not done:
        raise OysterbenchError("an image of the map could not be encoded")
    return data.tobytes()


def rgb(colour: str) -> tuple[int, int, int]:
    """Parse a colour #rrggbb."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
