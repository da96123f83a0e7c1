"""A sequence as one HTML page that needs nothing else: cameras, sonar fans, strips of the scalar sensors, the path."""

from __future__ import annotations

import base64
import json
from collections import Counter
from html import escape
from importlib import resources
from typing import Any

import numpy as np

from oysterbench.core.errors import SequenceError
from oysterbench.core.page import page
from oysterbench.report.viewer.strips import path_plot, strips
from oysterbench.sensors.panels import Panel
from oysterbench.sequence.types import Sequence

STEPS = 120
"""Moments that the page shows, at most."""

BYTES = 14_000_000
"""Size of all pictures together, at most; with many sensors there are fewer moments."""


def view_page(sequence: Sequence) -> str:
    """The page of a sequence, as a whole HTML document of at most some 20 MB, however long the sequence is."""
    start, end = _span(sequence)
    panels = pictures(sequence)
    times = moments(start, end, panels)
    shown: list[dict[str, Any]] = []
    for panel in panels:
        frames = [base64.b64encode(data).decode() for data in panel.frames(times)]
        shown.append({"frames": frames})
    seconds = (times - start) * 1e-9
    figures = "".join(
        f'<figure><img class="panel" alt="{escape(panel.title)}" width="{panel.width}" height="{panel.height}" '
        f'src="data:image/jpeg;base64,{entry["frames"][0]}"><figcaption>{escape(panel.title)}</figcaption></figure>'
        for panel, entry in zip(panels, shown, strict=True)
    )
    plots, path = strips(sequence, start, end), path_plot(sequence, times)
    if path is not None:
        figures += f'<figure class="path">{path.svg}<figcaption>{escape(path.title)}</figcaption></figure>'
    data = {
        "seconds": [round(float(second), 3) for second in seconds],
        "panels": shown,
        "path": [] if path is None else path.poses,
    }
    body = _BODY.format(
        name=escape(sequence.name),
        facts=escape(_facts(sequence, (end - start) * 1e-9)),
        last=len(times) - 1,
        figures=figures,
        strips="".join(plots),
        data=json.dumps(data).replace("<", "\\u003c"),
        style=_asset("view.css"),
        script=_asset("view.js"),
    )
    return page(f"{sequence.name}: sequence", body)


_BODY = """<style>{style}</style>
<h1>{name}</h1>
<p class="lead">{facts}</p>
<div class="player"><button id="play" type="button">Play</button>
<input id="time" type="range" min="0" max="{last}" value="0" aria-label="Time">
<output id="clock" for="time"></output></div>
<div class="panels">{figures}</div>
<div class="strips">{strips}</div>
<script id="data" type="application/json">{data}</script>
<script>{script}</script>"""


def pictures(sequence: Sequence) -> list[Panel]:
    """Of every sensor that shows any."""
    return [panel for name, kind in sequence.sensors().items() for panel in kind.panels(sequence, name)]


def moments(start_ns: int, end_ns: int, panels: list[Panel]) -> np.ndarray:
    """(n,) int64 stamps, evenly over the sequence: as many as the size of the page allows."""
    one = sum(panel.bytes_each for panel in panels) * 4 / 3  # base64
    n = int(np.clip(BYTES / max(one, 1.0), 2, STEPS))
    return np.linspace(start_ns, end_ns, n).astype(np.int64)


def _span(sequence: Sequence) -> tuple[int, int]:
    first = next(iter(sequence.imu()), None)
    if first is None:
        raise SequenceError(f"{sequence.name} has no inertial sample: nothing to show")
    return first.stamp_ns, first.stamp_ns + max(round(sequence.duration_s * 1e9), 1)


def _facts(sequence: Sequence, duration_s: float) -> str:
    counts = Counter(sequence.sensors().values())
    words = [kind.title if kind.single else f"{n} {kind.title}{'s' if n > 1 else ''}" for kind, n in counts.items()]
    split = sequence.metadata.get("split")
    return ", ".join([f"{duration_s:.1f} s", *([f"split {split}"] if split else []), *words])


def _asset(name: str) -> str:
    return (resources.files(__package__) / name).read_text(encoding="utf-8")
