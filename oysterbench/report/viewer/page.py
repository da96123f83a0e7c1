"""A sequence as one self-contained HTML page: camera images with overlaid ground-truth layers, sonar fans, strip charts
of the scalar sensors, the path.

The page can be played. If the part is short enough, it shows every frame, at the frame rate of the camera.
"""

from __future__ import annotations

import base64
import json
from collections import Counter
from collections.abc import Callable
from collections.abc import Sequence as Several
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from oysterbench.core.errors import SequenceError
from oysterbench.core.html import render
from oysterbench.report.viewer.estimates import EstimatedPath
from oysterbench.report.viewer.faults import fault_plot
from oysterbench.report.viewer.path import path_plot
from oysterbench.report.viewer.strips import strips
from oysterbench.sensors.camera_panels import CLASS_COLOURS
from oysterbench.sensors.panels import Panel
from oysterbench.sequence.types import Sequence

STEPS = 200
"""Maximum number of moments that the page shows."""

BYTES = 14_000_000
"""Maximum size of all images together, bytes; with many sensors there are fewer moments."""


Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Shown:
    """A panel on the page. number: its index in the page's data; layers: panels that can be overlaid on it."""

    number: int
    panel: Panel
    first: str
    layers: list[Shown]


def view_page(
    sequence: Sequence,
    begin_s: float = 0.0,
    seconds: float | None = None,
    estimates: Several[EstimatedPath] = (),
    progress: Progress = lambda done, total: None,
) -> str:
    """Make the page of a sequence, a complete HTML document of at most some 20 MB, however long the sequence is.

    It shows all of the sequence, or `seconds` from begin_s on. estimates: drawn beside the true path; progress: called
    after each image. Raises SequenceError where the part lies outside the sequence.
    """
    start, end = span_of(sequence, begin_s, seconds)
    panels = pictures(sequence)
    times = moments(start, end, panels, _fastest_hz(sequence))
    drawn = _drawn(panels, times, start, progress)
    path = path_plot(sequence, times, estimates)
    data = {
        "begin": begin_s,
        "origin": str(start),
        "seconds": [round(float(second), 3) for second in (times - start) * 1e-9],
        "panels": drawn,
        "path": [] if path is None else path.poses,
        "state": [] if path is None else path.states,
        "moving": [] if path is None else list(path.moving.values()),
    }
    context = {
        "title": f"{sequence.name}: sequence",
        "name": sequence.name,
        "facts": _facts(sequence, begin_s, (end - start) * 1e-9),
        "begin": begin_s,
        "last": len(times) - 1,
        "panels": _stacked(panels, [one["frames"][0] for one in drawn]),
        "classes": {name: "#{:02x}{:02x}{:02x}".format(*colour) for name, colour in CLASS_COLOURS.items()},
        "path": path,
        "plots": strips(sequence, start, end),
        "faults": fault_plot(sequence, start, end),
        "data": Markup(json.dumps(data).replace("<", "\\u003c")),
    }
    return render("view.html", context, __package__)


def _drawn(panels: list[Panel], times: np.ndarray, start_ns: int, progress: Progress) -> list[dict[str, Any]]:
    """Images of each panel in base64 and their stamps, ns since the start; None before the first image."""
    total, done = len(panels) * len(times), 0
    found = []
    for panel in panels:
        frames, stamps = [], []
        for frame in panel.frames(times):
            frames.append(base64.b64encode(frame.data).decode())
            stamps.append(None if frame.stamp_ns is None else int(frame.stamp_ns) - start_ns)
            done += 1
            progress(done, total)
        found.append({"frames": frames, "stamps": stamps})
    return found


def _stacked(panels: list[Panel], firsts: list[str]) -> list[Shown]:
    """Base panels, each with its overlay layers."""
    all_shown = [Shown(k, panel, firsts[k], []) for k, panel in enumerate(panels)]
    under = {shown.panel.title: shown for shown in all_shown if not shown.panel.over}
    for shown in all_shown:
        if shown.panel.over:
            under[shown.panel.over].layers.append(shown)
    return list(under.values())


def pictures(sequence: Sequence) -> list[Panel]:
    """Panels of all sensors that have any."""
    return [panel for name, kind in sequence.sensors().items() for panel in kind.panels(sequence, name)]


def moments(start_ns: int, end_ns: int, panels: list[Panel], rate_hz: float = 0.0) -> np.ndarray:
    """Stamps (n,) int64, evenly over the sequence: as many as the size of the page allows.

    If that is enough for every frame at rate_hz, the stamps of the frames.
    """
    one = sum(panel.bytes_each for panel in panels) * 4 / 3  # base64
    n = int(np.clip(BYTES / max(one, 1.0), 2, STEPS))
    frames = int((end_ns - start_ns) * 1e-9 * rate_hz + 1e-6) + 1
    if 2 <= frames <= n:
        return np.asarray(start_ns + np.rint(np.arange(frames) * (1e9 / rate_hz)).astype(np.int64))
    # Python's integers: floats round large stamps.
    return np.array([start_ns + (end_ns - start_ns) * k // (n - 1) for k in range(n)], dtype=np.int64)


def _fastest_hz(sequence: Sequence) -> float:
    """Highest frame rate of the cameras, Hz; 0 if there are none."""
    return max((camera.rate_hz for camera in sequence.cameras.values()), default=0.0)


def span_of(sequence: Sequence, begin_s: float, seconds: float | None) -> tuple[int, int]:
    """First and last stamp of a part of a sequence. Raises SequenceError where it lies outside."""
    first = next(iter(sequence.imu()), None)
    if first is None:
        raise SequenceError(f"{sequence.name} has no inertial sample: nothing to show")
    last = first.stamp_ns + max(round(sequence.duration_s * 1e9), 1)
    if last >= 2**63:
        raise SequenceError(f"{sequence.name} lasts {sequence.duration_s:.3g} s: expected stamps below 2^63 ns")
    beyond_s = (last - first.stamp_ns) * 1e-9 + 1.0  # longer times may have no whole number of ns
    start = first.stamp_ns + round(min(max(begin_s, -1.0), beyond_s) * 1e9)
    end = last if seconds is None else min(last, start + round(min(max(seconds, 0.0), beyond_s) * 1e9))
    if not first.stamp_ns <= start < end:
        raise SequenceError(
            f"{sequence.name} lasts {sequence.duration_s:.1f} s: expected a part of it, got "
            f"{'all' if seconds is None else f'{seconds:g} s'} from {begin_s:g} s on"
        )
    return start, end


def _facts(sequence: Sequence, begin_s: float, duration_s: float) -> str:
    counts = Counter(sequence.sensors().values())
    words = [kind.title if kind.single else f"{n} {kind.title}{'s' if n > 1 else ''}" for kind, n in counts.items()]
    split = sequence.metadata.get("split")
    part = f"{duration_s:.1f} s" + (f" from {begin_s:g} s on" if begin_s else "")
    return ", ".join([part, *([f"split {split}"] if split else []), *words, *_moving(sequence)])


def _moving(sequence: Sequence) -> list[str]:
    """Numbers of independently moving objects by class, in words."""
    try:
        counts = Counter(sequence.moving()["class"])
    except SequenceError:
        return []
    return [f"{n} {name}" for name, n in counts.items()]
