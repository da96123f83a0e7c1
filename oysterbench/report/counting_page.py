"""The HTML page of a count: what was counted, how certain it is, and what it looks like."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2
import numpy as np

from oysterbench.core.html import environment
from oysterbench.core.streams import stream
from oysterbench.counting.film import film_rate
from oysterbench.counting.measure import PictureCount
from oysterbench.counting.overlay import COLOURS, jpeg
from oysterbench.counting.store import Store
from oysterbench.counting.survey import PARTS, Survey
from oysterbench.evaluate.statistics import LEVEL
from oysterbench.hub.card import reached
from oysterbench.report.bars import histogram_plot
from oysterbench.report.cards import Card, Picture
from oysterbench.report.plots import Curve, time_plot
from oysterbench.report.renderers.html import FOLDER
from oysterbench.report.table import Column, Table, TableRow

SHOWN = 36  # images in the grid, evenly over all; thousands would make a page of many megabytes
SHOWN_UNLIKE = 12  # of the images warned about, the most unlike
LISTED = 60  # maximum number of lines in a list
TO_LABEL = 20  # images drawn at random for labelling
SHOWN_FILMS = 6  # videos whose counts over time are plotted
THUMBNAIL_PX = 480

SCALES = {
    "plain": "a length of {mm_per_px:g} mm per pixel, which holds for images taken straight down without distortion",
    "altitude": "a calibrated camera looking straight down onto a flat bottom from the given altitude",
    "quadrat": "the corners of a {size_m:g} m quadrat lying flat on the bottom",
}
"""Kind of scale -> where metres come from."""


def counting_page(
    found: Survey,
    films: Mapping[str, Path],
    store: Store,
    command: str,
    identity: Mapping[str, Any],
    settings: Mapping[str, Any],
    coco: bool = False,
) -> str:
    """Make the HTML page, which embeds small copies of images; images and films are beside it in the folder of `store`.
    coco: whether COCO annotations are there, too."""
    unlike = found.unlike
    warned = {one.name for one in unlike}
    shown = evenly([one for one in found.pictures if one.name not in warned], SHOWN)
    context = {
        "title": f"Oysters in {found.title}",
        "found": found,
        "lead": _lead(found),
        "measures": _measures(found),
        "intervals": any(one.ratio.interval.known for one in found.measures),
        "level": f"{100 * LEVEL:.0f} %",
        "charts": _charts(found),
        "unlike": unlike,
        "unlike_table": _unlike_table(unlike[:LISTED]),
        "unlike_pictures": [_picture(store, one) for one in unlike[:SHOWN_UNLIKE]],
        "pictures": [_picture(store, one) for one in shown],
        "failures": list(found.failures.items())[:LISTED],
        "films": [_film(found, store, name, path) for name, path in films.items()],
        "colours": _colours(found),
        "scale": _scale(settings),
        "accuracy": _accuracy(found, settings),
        "figures": [
            f"{one.heading[:1].lower()}{one.heading[1:]} on {one.split} {reached(one)} per image"
            for one in found.figures
        ],
        "settings": settings,
        "coco": coco,
        "command": command,
        "to_label": drawn([one.name for one in found.pictures if not one.video]),
        "reference": shlex.quote(str(identity.get("method", found.method))),
        "making": _making(identity, settings),
    }
    return environment(FOLDER).get_template("counting.html").render(**context)


def evenly(pictures: Sequence[PictureCount], most: int) -> list[PictureCount]:
    """Choose at most `most` of the images, evenly over all, in order."""
    places = np.unique(np.linspace(0, len(pictures) - 1, min(most, len(pictures))).round().astype(int))
    return [pictures[k] for k in places]


def drawn(names: Sequence[str], most: int = TO_LABEL) -> list[str]:
    """Draw at most `most` names at random, in order; the same number of names always gives the same draw."""
    chosen = stream(0, b"", "counting", "label", len(names)).permutation(len(names))[:most]
    return [names[k] for k in sorted(chosen.tolist())]


def _lead(found: Survey) -> str:
    frames = sum(one.video for one in found.pictures)
    videos = len({one.file for one in found.pictures if one.video})
    parts = []
    if pictures := len(found.pictures) - frames:
        parts.append(f"{pictures} image{'s' * (pictures != 1)}")
    if frames:
        parts.append(f"{frames} frame{'s' * (frames != 1)} of {videos} video{'s' * (videos != 1)}")
    if not parts:
        return "Nothing could be counted."
    what = f"{PARTS}," if found.parts else "oyster" if found.oysters == 1 else "oysters"
    return f"{found.oysters} {what} in {' and '.join(parts)}, by {found.method}."


def _measures(found: Survey) -> Table:
    columns = (
        Column("quantity", "Mean"),
        Column("value", "Value", kind="number"),
        Column("interval", f"{100 * LEVEL:.0f} % interval", "of sampling", kind="number"),
        Column("blocks", "Over", found.block, kind="number"),
        Column("about", "What it is"),
    )
    rows, reasons = [], []
    for one in found.measures:
        number = Column("", digits=one.digits)
        interval = one.ratio.interval
        unit = f" {one.unit}" if one.unit else ""
        text = Column("", kind="interval", digits=one.digits).text(interval)
        rows.append(TableRow((one.heading, number.text(one.ratio.value) + unit, text, one.ratio.blocks, one.about)))
        reasons += [] if interval.known else [interval.reason]
    return Table("Means", columns, tuple(rows), tuple(dict.fromkeys(f"{reason}." for reason in reasons)))


def _charts(found: Survey) -> list[Card]:
    """Charts of the distribution of counts, of the counts of images in order, and over the time of each video."""
    if not found.pictures:
        return []
    title = "Images by number of oysters"
    charts = [
        Card(title, histogram_plot([one.oysters for one in found.pictures], title, "oysters in an image", "images"))
    ]
    pictures = [one.oysters for one in found.pictures if not one.video]
    if len(pictures) > 1:
        title = "Oysters in each image, in order of name"
        order = np.arange(1, len(pictures) + 1, dtype=float)
        curve = Curve("oysters", order, np.array(pictures, dtype=float), 1)
        charts.append(Card(title, time_plot([curve], title, "image", "oysters", (1.0, float(len(pictures))))))
    videos: dict[str, list[PictureCount]] = {}
    for one in found.pictures:
        if one.time_s is not None:
            videos.setdefault(one.name.rpartition("/")[0], []).append(one)
    for name, frames in list(videos.items())[:SHOWN_FILMS]:
        times = np.array([one.time_s for one in frames], dtype=float)
        counts = np.array([one.oysters for one in frames], dtype=float)
        if len(frames) > 1:
            title = f"{name}: oysters over time"
            curve = Curve("oysters", times, counts, 1)
            span = (float(times[0]), float(times[-1]))
            charts.append(Card(title, time_plot([curve], title, "time [s]", "oysters in a frame", span)))
    return charts


def _unlike_table(unlike: Sequence[PictureCount]) -> Table:
    columns = (
        Column("picture", "Image"),
        Column("novelty", "Novelty", "above 1: unlike", kind="number", digits=2),
        Column("oysters", "Oysters", kind="number"),
    )
    return Table("Unlike", columns, tuple(TableRow((one.name, one.novelty, one.oysters)) for one in unlike))


def _percent(share: float) -> str:
    """Per cent without decimals; below 1 with one digit, so that some is not none."""
    return f"{100 * share:.0f}" if share >= 0.01 else f"{100 * share:.1g}"


def _picture(store: Store, one: PictureCount) -> Picture:
    data = np.frombuffer(store.overlay(one.name).read_bytes(), np.uint8)
    pixels = np.asarray(cv2.cvtColor(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR)), cv2.COLOR_BGR2RGB), np.uint8)
    small = one.said
    if one.cover is not None:
        small += f", {_percent(one.cover)} % covered"
    return Picture(jpeg(pixels, 80, THUMBNAIL_PX), one.name, small, f"{one.name} with outlines of {small}")


def _film(found: Survey, store: Store, name: str, path: Path) -> dict[str, str]:
    times = [one.time_s or 0.0 for one in found.pictures if one.video and one.name.rpartition("/")[0] == name]
    span_s = times[-1] - times[0] if len(times) > 1 else 0.0
    fast = film_rate(times) * span_s / max(len(times) - 1, 1)
    speed = f", {fast:.0f} times as fast as recorded" if fast >= 1.5 else ""
    return {"name": name, "address": quote(path.relative_to(store.folder).as_posix()), "speed": speed}


def _colours(found: Survey) -> list[tuple[str, str]]:
    """Legend: colours of the outlines, with their meaning."""
    states = {"live": "live", "dead": "dead", "unknown": "not told"}
    kinds = states if found.tells_state else {"unknown": "oyster"}
    reasons = ["its centre is outside"] * any(one.area_m2 is not None for one in found.pictures)
    reasons += ["it is too small"] * bool(found.small)
    if reasons:
        kinds["left out"] = f"not counted: {' or '.join(reasons)}"
    return [(f"rgb{COLOURS[kind]}", text) for kind, text in kinds.items()]


def _scale(settings: Mapping[str, Any]) -> str:
    scale = settings.get("scale") or {}
    return SCALES[scale["kind"]].format(**scale) if scale else ""


def _accuracy(found: Survey, settings: Mapping[str, Any]) -> str:
    """Counting error of the method on labelled images, in words, and how that count differs from the page's, which has
    these settings; empty if it is not known."""
    one, threshold = found.accuracy, settings.get("threshold")
    if one is None or math.isnan(one.percent):
        return ""
    direction = "too many" if one.percent > 0 else "too few"
    size = f"{abs(one.percent):.0f}" if abs(one.percent) >= 1 else f"{abs(one.percent):.1g}"
    error = f"{size} % {direction}" if one.percent else "as many"
    differing = [f"what is smaller than {found.at_least}, too"] if found.at_least else []
    if (settings.get("scale") or {}).get("kind") == "quadrat":
        differing.append("what is outside the quadrats, too")
    if one.threshold not in (None, threshold):
        differing.append(f"from a score of {one.threshold:g}, not {threshold:g}")
    unlike = f" Unlike this page, that check counts {', and '.join(differing)}." if differing else ""
    return (
        f"On labelled images ({one.where}), {found.method} counted {one.counted:.0f} oysters where "
        f"{one.labelled:.0f} are labelled: {error}"
        f"{', but with different weights' if one.other_weights else ''}.{unlike}"
    )


def _making(identity: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, str]:
    """Method, versions, files and settings, one line each."""
    versions = ", ".join(f"{name} {version}" for name, version in identity.get("versions", {}).items())
    files = ", ".join(f"{name} {digest[:16]}" for name, digest in identity.get("files", {}).items())
    values = ", ".join(f"{key} = {json.dumps(value)}" for key, value in settings.items() if value is not None)
    lines = {
        "Method": str(identity.get("method", "")),
        "Versions": versions,
        "Weights, SHA-256": files,
        "Settings": values,
    }
    return {key: value for key, value in lines.items() if value}
