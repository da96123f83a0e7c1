"""Rollouts over a reef: each policy's path from above with what it saw, and the oysters seen over time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from oysterbench.evaluate.steering import RolloutLog
from oysterbench.evaluate.steering.rollouts import episodes, seen_so_far
from oysterbench.report.drawing import INK, SOFT, Drawing
from oysterbench.report.plots import nice_ticks

PANEL, GAP, MARGIN, TOP, HEAD, FOOT = 340.0, 26.0, 30.0, 96.0, 44.0, 54.0
PER_ROW = 4
CHART, AXIS = 250.0, 56.0
GROUND, UNSEEN, CONTACT = "#f3efe6", "#c3bcae", "#d1001f"

OWN = {"expert": "#00805d", "lawnmower": "#0067a5", "random": "#a33d86"}
"""Colours of the references, alike in all figures; ..."""
OTHERS = ("#c84c00", "#3f6ad8", "#8a6100", "#444444", "#5b6b00")
"""... those of methods, in their order (after Okabe & Ito 2008, darkened for paper)."""


def colours_of(policies: Sequence[str]) -> dict[str, str]:
    """A colour for each policy."""
    methods = [policy for policy in policies if policy not in OWN]
    return {policy: OWN.get(policy) or OTHERS[methods.index(policy) % len(OTHERS)] for policy in policies}


def dives_figure(reef: str, logs: Mapping[str, RolloutLog], colours: Mapping[str, str]) -> Drawing:
    """Rollouts of policies, at least one, over one reef."""
    rows = math.ceil(len(logs) / PER_ROW)
    columns = math.ceil(len(logs) / rows)
    width = 2 * MARGIN + columns * PANEL + (columns - 1) * GAP
    width = max(width, 2 * MARGIN + 2 * PANEL + GAP)
    below = TOP + rows * (HEAD + PANEL + GAP) + FOOT
    sheet = Drawing(width, below + 30 + CHART + AXIS + 10, f"Rollouts over {reef}")
    first = next(iter(logs.values()))
    sheet.text(MARGIN, 36, f"Rollouts over {reef}", 21, bold=True)
    seconds = max(log.step_s * len(log.commands) for log in logs.values())
    sheet.text(
        MARGIN,
        60,
        f"{seconds:g} s each, from the same place; {len(first.oysters)} live oysters on "
        f"{2 * first.half_m:g} m x {2 * first.half_m:g} m within the fence",
        14,
        fill=SOFT,
    )
    for k, (policy, log) in enumerate(logs.items()):
        left = MARGIN + (k % columns) * (PANEL + GAP)
        top = TOP + (k // columns) * (HEAD + PANEL + GAP) + HEAD
        _from_above(sheet, left, top, policy, log, colours[policy])
    _scale_bar(sheet, MARGIN, below - FOOT + 14, PANEL / _span(first))
    _legend(sheet, MARGIN + 200, below - FOOT + 14)
    _over_time(sheet, below + 30, width, logs, colours)
    return sheet


def _span(log: RolloutLog) -> float:
    """Metres that a panel shows: the area and a little around."""
    return 2 * log.half_m * 1.04


def _from_above(sheet: Drawing, left: float, top: float, policy: str, log: RolloutLog, colour: str) -> None:
    per_m = PANEL / _span(log)
    middle = (left + PANEL / 2, top + PANEL / 2)

    def place(x: float, y: float) -> tuple[float, float]:
        return middle[0] + x * per_m, middle[1] - y * per_m

    minutes = log.step_s * len(log.commands) / 60.0
    sheet.text(left, top - 27, policy, 16, bold=True, fill=colour)
    contacts = episodes(log.contact)
    said = f"{log.seen.sum()} seen" + (f", {log.seen.sum() / minutes:.0f} per min" if minutes else "")
    said += f"; {log.covered[-1]:.0%} covered; {contacts} contact{'' if contacts == 1 else 's'}"
    sheet.text(left, top - 9, said, 13, fill=INK)
    sheet.rect(left, top, PANEL, PANEL, GROUND)
    radius = min(2.6, max(1.1, 0.07 * per_m))
    for seen in (False, True):
        at = [place(x, y) for x, y in log.oysters[log.found == seen, :2].tolist()]
        sheet.dots(at, radius, colour if seen else UNSEEN)
    corner = place(-log.half_m, log.half_m)
    sheet.rect(*corner, 2 * log.half_m * per_m, 2 * log.half_m * per_m, stroke=INK, thick=1.2)
    way = [place(x, y) for x, y in log.states[:, :2].tolist()]
    for thick, stroke in ((4.4, "#ffffff"), (2.0, INK)):
        sheet.path(way, stroke, thick)
    for (x, y), touched in zip(way, log.contact.tolist(), strict=True):
        if touched:
            _cross(sheet, x, y)
    sheet.dot(*way[0], 5.0, "#ffffff", INK)
    sheet.rect(way[-1][0] - 4.5, way[-1][1] - 4.5, 9, 9, INK)


def _cross(sheet: Drawing, x: float, y: float) -> None:
    sheet.line(x - 5, y - 5, x + 5, y + 5, CONTACT, 2.2)
    sheet.line(x - 5, y + 5, x + 5, y - 5, CONTACT, 2.2)


def _scale_bar(sheet: Drawing, x: float, y: float, per_m: float) -> None:
    metres = max((m for m in (0.5, 1, 2, 5, 10, 20, 50) if m * per_m <= 0.35 * PANEL), default=0.5)
    for k in range(4):
        sheet.rect(x + k * metres * per_m / 4, y - 6, metres * per_m / 4, 7, INK if k % 2 == 0 else "#ffffff", INK, 0.8)
    sheet.text(x + metres * per_m + 10, y + 2, f"{metres:g} m", 13)


def _legend(sheet: Drawing, x: float, y: float) -> None:
    sheet.dot(x, y - 2, 4, UNSEEN)
    sheet.text(x + 10, y + 2, "not seen", 13)
    for k, colour in enumerate((*list(OWN.values())[:2], OTHERS[0])):
        sheet.dot(x + 90 + 9 * k, y - 2, 4, colour)
    sheet.text(x + 120, y + 2, "seen", 13)
    sheet.dot(x + 172, y - 2, 5, "#ffffff", INK)
    sheet.text(x + 183, y + 2, "begin", 13)
    sheet.rect(x + 236, y - 6.5, 9, 9, INK)
    sheet.text(x + 251, y + 2, "end", 13)
    _cross(sheet, x + 300, y - 2)
    sheet.text(x + 312, y + 2, "contact", 13)
    sheet.text(x, y + 24, "From above; up is +y of the map, right is +x. The frame is the fence.", 12.5, fill=SOFT)


def _over_time(
    sheet: Drawing, top: float, width: float, logs: Mapping[str, RolloutLog], colours: Mapping[str, str]
) -> None:
    """Curves, each named at its end; names that would meet are moved apart."""
    room = max(100.0, 8.6 * max(map(len, logs)) + 14.0)
    left, right, bottom = MARGIN + 44, width - MARGIN - room, top + CHART
    curves = {policy: seen_so_far(log) for policy, log in logs.items()}
    end = max(float(time[-1]) for time, _ in curves.values()) or 1.0
    most = max(1.0, *(float(seen[-1]) for _, seen in curves.values())) * 1.05
    sheet.text(MARGIN, top - 12, "Live oysters seen so far", 15, bold=True)
    for value, label in nice_ticks(0.0, most, 5):
        y = bottom - value / most * CHART
        sheet.line(left, y, right, y, "#e3e7eb", 1)
        sheet.text(left - 8, y + 5, label, 13, "end", fill=SOFT)
    for value, label in nice_ticks(0.0, end, 8):
        x = left + value / end * (right - left)
        sheet.line(x, bottom, x, bottom + 5, SOFT, 1)
        sheet.text(x, bottom + 21, label, 13, "middle", fill=SOFT)
    sheet.text(right, bottom + 42, "time, s", 13, "end", fill=SOFT)
    sheet.line(left, bottom, right, bottom, SOFT, 1)
    ends = {}
    for policy, (time, seen) in curves.items():
        across, up = left + time / end * (right - left), bottom - seen / most * CHART
        points = list(zip(across.tolist(), up.tolist(), strict=True))
        sheet.path(points, colours[policy], 2.6)
        ends[policy] = points[-1][1]
    names = sorted(ends, key=lambda policy: ends[policy])
    places = apart([ends[policy] for policy in names], 18.0, bottom - 5.0)
    for policy, y in zip(names, places, strict=True):
        sheet.text(right + 8, y + 5, policy, 14, bold=True, fill=colours[policy])


def apart(places: Sequence[float], room: float, last: float = math.inf) -> list[float]:
    """Rising places moved so that each has so much room, as little as can be in the sum of squares; those that touch
    keep their middle. The greatest is `last` at most."""
    blocks: list[tuple[float, int]] = []  # sums and numbers of those that touch, each less the room before it
    for k, place in enumerate(places):
        blocks.append((place - k * room, 1))
        while len(blocks) > 1 and blocks[-2][0] / blocks[-2][1] > blocks[-1][0] / blocks[-1][1]:
            total, n = blocks.pop()
            blocks[-1] = (blocks[-1][0] + total, blocks[-1][1] + n)
    level = [total / n for total, n in blocks for _ in range(n)]
    count = len(level)
    return [min(value + k * room, last - (count - 1 - k) * room) for k, value in enumerate(level)]
