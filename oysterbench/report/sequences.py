"""Plots of one sequence in the report: paths, errors over time and along the path, recall, camera frames."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.trajectory import Trajectory, ns_to_seconds
from oysterbench.evaluate.slam.scoring import SlamResult
from oysterbench.report.cards import Card, Picture
from oysterbench.report.components import component_cards
from oysterbench.report.consistency import consistency_cards, health_cards
from oysterbench.report.plots import Curve, broken, height_plot, map_plot, recall_plot, thin, time_plot
from oysterbench.results.records import ResultRecord

TIME = "time since start [s]"
ALONG = "distance along the true path [m]"
MAP_POINTS = 1500  # per path: still fine at ten times the zoom


@dataclass(frozen=True)
class SlamRun:
    """One run for the report: its record, its result if it was scored, camera frames as (stamp in ns, JPEG), and the
    `Health` (N,) of its matched poses, if it reports them."""

    record: ResultRecord
    result: SlamResult | None = None
    frames: Sequence[tuple[int, bytes]] = ()
    health: NDArray[np.uint8] | None = None


Scored = Sequence[tuple[str, SlamResult]]
"""Method and result of the runs that are drawn."""


@dataclass(frozen=True)
class SequencePlots:
    """Plots and frames shown for a sequence; no plots if no run could be scored."""

    name: str
    facts: str
    legend: tuple[tuple[str, int], ...] = ()
    above: Card | None = None
    beside: Card | None = None
    height: Card | None = None
    rows: tuple[tuple[Card, ...], ...] = ()
    frames: tuple[Picture, ...] = ()


def sequence_plots(runs: Sequence[SlamRun], name: str, styles: Mapping[str, int]) -> SequencePlots:
    """Plots and frames of one sequence."""
    drawn = _drawn(runs)
    scored = [(run.record.method, run.result) for run in drawn if run.result is not None]
    frames = next((run.frames for run in runs if run.frames), ())
    if not scored:
        pictures = tuple(_frame(*frame, None) for frame in frames)
        return SequencePlots(name, "None of the runs just made on this sequence could be scored.", frames=pictures)
    truth = scored[0][1].whole_truth
    north = any(run.record.split_digest for run in runs)  # the map frame of our splits is east, north, up
    begin_ns = int(truth.stamps_ns[0])
    end_s = (int(truth.stamps_ns[-1]) - begin_ns) * 1e-9
    several = " Of several runs, the one with the median score is drawn." if len(drawn) < len(runs) else ""
    facts = (
        f"{truth.path_length:.1f} m of path in {end_s:.1f} s, from timestamp {ns_to_seconds(begin_ns)} s. "
        f"Estimates are shown where they have poses, aligned by {_alignments(scored)}.{several}"
    )
    legend = (("truth", 0), *((method, styles[method]) for method, _ in scored))
    healths = {run.record.method: run.health for run in drawn if run.result is not None and run.health is not None}
    rows = (
        _errors(truth, end_s, scored, styles),
        *component_cards(truth, scored, styles, north),
        _last(truth, scored, styles),
        consistency_cards(truth, scored, styles),
        health_cards(truth, scored, healths, styles),
    )
    pictures = tuple(_frame(*frame, begin_ns) for frame in frames)
    return SequencePlots(name, facts, legend, *_maps(truth, scored, styles, north), tuple(filter(None, rows)), pictures)


def _alignments(scored: Scored) -> str:
    """Alignment of the methods; with their names where there are several."""
    by_align: dict[str, list[str]] = {}
    for method, result in scored:
        by_align.setdefault(result.settings.align, []).append(method)
    if len(by_align) == 1:
        return next(iter(by_align))
    return ", ".join(f"{align} ({', '.join(methods)})" for align, methods in by_align.items())


def _drawn(runs: Sequence[SlamRun]) -> list[SlamRun]:
    """Choose for each method the run with the median score (the lower of two) among those that were scored."""
    methods: dict[str, list[SlamRun]] = {}
    for run in runs:
        methods.setdefault(run.record.method, []).append(run)
    drawn = []
    for several in methods.values():
        scored = [run for run in several if run.result is not None] or several[:1]
        ordered = sorted(scored, key=lambda run: _score(run.record))
        drawn.append(ordered[(len(ordered) - 1) // 2])
    return drawn


def _score(record: ResultRecord) -> float:
    value = record.metrics.get("score", math.nan)
    return -1.0 if math.isnan(value) else value


def _maps(truth: Trajectory, scored: Scored, styles: Mapping[str, int], north: bool) -> tuple[Card, Card, Card]:
    """The trajectories from above, from the side that shows more of them, and their height over time."""
    extent = np.ptp(truth.positions, axis=0)
    side = 0 if extent[0] >= extent[1] else 1
    axes = (*(("x (east) [m]", "y (north) [m]") if north else ("x [m]", "y [m]")), "z (up) [m]")
    shown = [("truth", truth, 0), *((method, result.estimate, styles[method]) for method, result in scored)]

    def seen(title: str, i: int, j: int, least_height: float) -> Card:
        curves = [_outline(*entry, i, j) for entry in shown]
        return Card(title, map_plot(curves, title, axes[i], axes[j], least_height))

    begin_ns, end_s = int(truth.stamps_ns[0]), float(truth.stamps_ns[-1] - truth.stamps_ns[0]) * 1e-9
    heights = []
    for label, trajectory, style in shown:
        seconds = (trajectory.stamps_ns - begin_ns) * 1e-9
        heights.append(Curve(label, *broken(trajectory.stamps_ns, seconds, trajectory.positions[:, 2]), style))
    title = "Height over time"
    height = Card(title, height_plot(heights, title, TIME, axes[2], (0.0, end_s)))
    return seen("Seen from above", 0, 1, 400.0), seen("Seen from the side", side, 2, 110.0), height


def _outline(label: str, trajectory: Trajectory, style: int, i: int, j: int) -> Curve:
    """Curve of coordinates i and j of a trajectory, thinned evenly, and broken at gaps in its stamps."""
    step = max(1, len(trajectory) // MAP_POINTS)
    index = np.unique(np.r_[0 : len(trajectory) : step, len(trajectory) - 1])
    stamps, positions = trajectory.stamps_ns[index], trajectory.positions[index]
    return Curve(label, *broken(stamps, positions[:, i], positions[:, j]), style)


def _errors(truth: Trajectory, end_s: float, scored: Scored, styles: Mapping[str, int]) -> tuple[Card, ...]:
    """Translation and rotation error over time."""
    cards = []
    for title, unit, key in (
        ("Position error over time", "error [m]", "error_m"),
        ("Rotation error over time", "error [deg]", "rotation_error_deg"),
    ):
        curves = []
        for method, result in scored:
            seconds = (result.stamps_ns - truth.stamps_ns[0]) * 1e-9
            curves.append(thin(Curve(method, *broken(result.stamps_ns, seconds, getattr(result, key)), styles[method])))
        cards.append(Card(title, time_plot(curves, title, TIME, unit, (0.0, end_s))))
    return tuple(cards)


def _last(truth: Trajectory, scored: Scored, styles: Mapping[str, int]) -> tuple[Card, ...]:
    """Plot position error along the path, and recall curves; neither exists if the ground truth stands still."""
    steps = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1)
    way = np.r_[0.0, np.cumsum(steps)]
    seconds = (truth.stamps_ns - truth.stamps_ns[0]) * 1e-9
    if not way[-1] > 0:
        return ()
    along, curves = [], []
    for method, result in scored:
        x = np.interp((result.stamps_ns - truth.stamps_ns[0]) * 1e-9, seconds, way)
        along.append(thin(Curve(method, *broken(result.stamps_ns, x, result.error_m), styles[method])))
        if result.recall is not None:
            multiples = np.asarray(result.recall.error_m) / result.recall.scale_m
            curves.append(Curve(method, multiples, np.asarray(result.recall.share), styles[method]))
    title = "Position error along the path"
    cards = [Card(title, time_plot(along, title, ALONG, "error [m]", (0.0, float(way[-1]))))]
    if curves:
        percent = scored[0][1].settings.recall_scale_percent
        scale = next(result.recall.scale_m for _, result in scored if result.recall is not None)
        unit = f"{percent:g} % of the path, {scale:.3g} m"
        title = "Recall: share of ground-truth poses within an error"
        plot = recall_plot(curves, title, f"error [{unit}]", "share")
        cards.append(Card(title, plot, "The area under a curve is its score."))
    return tuple(cards)


def _frame(stamp_ns: int, jpeg: bytes, begin_ns: int | None) -> Picture:
    stamp = ns_to_seconds(stamp_ns)
    if begin_ns is None:
        return Picture(jpeg, f"stamp {stamp}", "", f"Camera frame at {stamp}")
    since = f"{(stamp_ns - begin_ns) * 1e-9:.2f} s"
    return Picture(jpeg, since, f"(stamp {stamp})", f"Camera frame at {since}")
