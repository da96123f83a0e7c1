"""A sequence as one HTML page that needs nothing else: cameras, sonar fans, strips of the scalar sensors, the path."""

from __future__ import annotations

import base64
import json
from collections import Counter

import numpy as np
from markupsafe import Markup

from oysterbench.core.errors import SequenceError
from oysterbench.core.html import render
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
    shown = [[base64.b64encode(data).decode() for data in panel.frames(times)] for panel in panels]
    path = path_plot(sequence, times)
    data = {
        "seconds": [round(float(second), 3) for second in (times - start) * 1e-9],
        "panels": [{"frames": frames} for frames in shown],
        "path": [] if path is None else path.poses,
    }
    context = {
        "title": f"{sequence.name}: sequence",
        "name": sequence.name,
        "facts": _facts(sequence, (end - start) * 1e-9),
        "last": len(times) - 1,
        "panels": list(zip(panels, shown, strict=True)),
        "path": path,
        "plots": strips(sequence, start, end),
        "data": Markup(json.dumps(data).replace("<", "\\u003c")),
    }
    return render("view.html", context, __package__)


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
