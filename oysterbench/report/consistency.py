"""Consistency of the uncertainty that methods report: NEES over time and by state, and the source of each pose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.scoring import SlamResult
from oysterbench.methods.health import Health
from oysterbench.report.cards import Card
from oysterbench.report.columns import name_columns
from oysterbench.report.plots import Curve, nees_plot, states_plot
from oysterbench.report.table import Column, Table, TableRow
from oysterbench.results.labels import names_of_runs
from oysterbench.results.records import ResultRecord

TIME = "time since start [s]"
STATES = {Health.COASTING: "coasts", Health.TRACKING: "tracks", Health.RELOCALISED: "found"}
"""Name of each state, short enough for the axis."""

_KEYS = ("nees_position", "nees_rotation", "within_3sigma_position", "within_3sigma_rotation")
_COLUMNS = (
    *name_columns("sequence", "method"),
    Column("nees_position", "NEES\nposition", kind="number", digits=1, about="Mean; 3 is expected."),
    Column("nees_rotation", "NEES\nrotation", kind="number", digits=1, about="Mean; 3 is expected."),
    Column("within_3sigma_position", "3 sigma\nposition", "%", "number", digits=1, factor=100.0),
    Column("within_3sigma_rotation", "3 sigma\nrotation", "%", "number", digits=1, factor=100.0),
)
_SHOWN = (Health.TRACKING, Health.RELOCALISED, Health.COASTING)
_OF_STATE = ("share", "ate_rmse_m", "nees_position")


def consistency_table(records: Sequence[ResultRecord]) -> Table | None:
    """Table with a row for each run that reports its uncertainty or the source of its poses; None if none does.

    States that occur have columns of their own: their share, and the error and NEES in them.
    """
    known = [record for record in records if record.info.get("health") or _is_sure(record)]
    states = [one for one in _SHOWN if any(_name(one) in record.info.get("health", {}) for record in known)]
    names = names_of_runs([(one.method, one.sequence, one.run) for one in known])
    rows = []
    for record, name in zip(known, names, strict=True):
        by_state: Mapping[str, Mapping[str, float | None]] = record.info.get("health", {})
        values = [record.metrics.get(key) for key in _KEYS]
        for state in states:
            of = by_state.get(_name(state), {"share": 0.0} if by_state else {})
            values += [of.get(key) for key in _OF_STATE]
        rows.append(TableRow((record.sequence, name, *values)))
    note = (
        "NEES is the squared error over its covariance: 3 for a consistent estimate, more for an overconfident one. "
        "Relocalised: it tracks after a loss, and a loop closure ties it to what was seen before."
    )
    columns = (*_COLUMNS, *(column for state in states for column in _columns(_name(state))))
    return Table("Consistency, and source of each pose", columns, tuple(rows), (note,)) if rows else None


def _name(state: Health) -> str:
    return state.name.lower()


def _is_sure(record: ResultRecord) -> bool:
    values = (record.metrics.get(key) for key in _KEYS)
    return any(value is not None and math.isfinite(value) for value in values)


def _columns(state: str) -> tuple[Column, ...]:
    """Columns of a state, one for each of `_OF_STATE`."""
    heading = state.capitalize()
    return (
        Column(f"{state}_share", heading, "% of poses", "number", digits=1, factor=100.0),
        Column(f"{state}_ate_rmse_m", f"{heading}\nATE", "m", "number", digits=3),
        Column(f"{state}_nees_position", f"{heading}\nNEES", kind="number", digits=1),
    )


def consistency_cards(
    truth: Trajectory, scored: Sequence[tuple[str, SlamResult]], styles: Mapping[str, int]
) -> tuple[Card, ...]:
    """Plots of the NEES of position and rotation over time, for the methods that report their uncertainty."""
    end_s = float(truth.stamps_ns[-1] - truth.stamps_ns[0]) * 1e-9
    cards = []
    for part in ("position", "rotation"):
        curves = []
        for method, result in scored:
            if part in result.nees:
                values = result.nees[part].values
                seconds = (result.stamps_ns[len(result.stamps_ns) - len(values) :] - truth.stamps_ns[0]) * 1e-9
                curves.append(Curve(method, seconds, values, styles[method]))
        if curves:
            title = f"NEES of {part} over time"
            freedom = next(result.nees[part].freedom for _, result in scored if part in result.nees)
            plot = nees_plot(curves, title, TIME, "e\N{SUPERSCRIPT TWO} / covariance", (0.0, end_s), freedom)
            cards.append(Card(title, plot, f"Shaded: range of 95 % of a consistent estimate's values; mean {freedom}."))
    return tuple(cards)


def health_cards(
    truth: Trajectory,
    scored: Sequence[tuple[str, SlamResult]],
    healths: Mapping[str, np.ndarray],
    styles: Mapping[str, int],
) -> tuple[Card, ...]:
    """Plot of the source of each pose over time, for the methods that report it; healths: method -> `Health` (N,) at
    its matched stamps."""
    end_s = float(truth.stamps_ns[-1] - truth.stamps_ns[0]) * 1e-9
    curves = []
    for method, result in scored:
        if method in healths:
            seconds = (result.stamps_ns - truth.stamps_ns[0]) * 1e-9
            curves.append(Curve(method, seconds, healths[method].astype(float), styles[method]))
    if not curves:
        return ()
    title = "Source of each pose"
    plot = states_plot(curves, title, TIME, "state", (0.0, end_s), [STATES[health] for health in Health])
    return (Card(title, plot, "Found: it tracks after a loss, and a loop closure ties it to what was seen before."),)
