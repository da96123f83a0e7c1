"""How sure methods are and how sure they may be: NEES over time and by state, and how each pose was had."""

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
from oysterbench.results.records import ResultRecord

TIME = "time since start [s]"
STATES = {Health.COASTING: "coasts", Health.TRACKING: "tracks", Health.RELOCALISED: "found"}
"""As short as the axis asks for."""

_KEYS = ("nees_position", "nees_rotation", "within_3sigma_position", "within_3sigma_rotation")
_COLUMNS = (
    *name_columns("sequence", "method"),
    Column("nees_position", "NEES\nposition", kind="number", digits=1, about="Mean; 3 is expected."),
    Column("nees_rotation", "NEES\nrotation", kind="number", digits=1, about="Mean; 3 is expected."),
    Column("within_3sigma_position", "3 sigma\nposition", "%", "number", digits=1, factor=100.0),
    Column("within_3sigma_rotation", "3 sigma\nrotation", "%", "number", digits=1, factor=100.0),
    *(
        Column(f"{health.name.lower()}_{key}", f"{health.name.capitalize()}{heading}", unit, "number", **look)
        for health in (Health.TRACKING, Health.RELOCALISED, Health.COASTING)
        for key, heading, unit, look in (
            ("share", "", "% of poses", {"digits": 1, "factor": 100.0}),
            ("ate_rmse_m", "\nATE", "m", {"digits": 3}),
            ("nees_position", "\nNEES", "", {"digits": 1}),
        )
    ),
)


def consistency_table(records: Sequence[ResultRecord]) -> Table | None:
    """A row for each run that says how sure it is or how it had its poses; None where none does."""
    rows = []
    for record in records:
        by_state: Mapping[str, Mapping[str, float | None]] = record.info.get("health", {})
        known = [record.metrics.get(key) for key in _KEYS]
        if not by_state and not any(value is not None and math.isfinite(value) for value in known):
            continue
        for health in (Health.TRACKING, Health.RELOCALISED, Health.COASTING):
            of = by_state.get(health.name.lower(), {"share": 0.0} if by_state else {})
            known += [of.get(key) for key in ("share", "ate_rmse_m", "nees_position")]
        rows.append(TableRow((record.sequence, record.method, *known)))
    note = (
        "NEES is the squared error over its covariance: 3 where an estimate is as sure as it may be, more where it "
        "promises too much. Relocalised: it tracks after a loss, and a loop ties it to what was seen before."
    )
    return Table("How sure, and how each pose was had", _COLUMNS, tuple(rows), (note,)) if rows else None


def consistency_cards(
    truth: Trajectory, scored: Sequence[tuple[str, SlamResult]], styles: Mapping[str, int]
) -> tuple[Card, ...]:
    """NEES of position and of rotation over time, of the methods that say how sure they are."""
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
            cards.append(
                Card(title, plot, f"Shaded is where 95 % of a consistent estimate's values lie; mean {freedom}.")
            )
    return tuple(cards)


def health_cards(
    truth: Trajectory,
    scored: Sequence[tuple[str, SlamResult]],
    healths: Mapping[str, np.ndarray],
    styles: Mapping[str, int],
) -> tuple[Card, ...]:
    """How each pose was had over time, of the methods that say so; healths: (N,) of a method's matched stamps."""
    end_s = float(truth.stamps_ns[-1] - truth.stamps_ns[0]) * 1e-9
    curves = []
    for method, result in scored:
        if method in healths:
            seconds = (result.stamps_ns - truth.stamps_ns[0]) * 1e-9
            curves.append(Curve(method, seconds, healths[method].astype(float), styles[method]))
    if not curves:
        return ()
    title = "How each pose was had"
    plot = states_plot(curves, title, TIME, "state", (0.0, end_s), [STATES[health] for health in Health])
    return (Card(title, plot, "Found: it tracks after a loss, and a loop ties it to what was seen before."),)
