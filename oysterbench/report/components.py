"""Errors along each axis over time: of the position in the map frame, of the attitude in the body frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.scoring import SlamResult
from oysterbench.report.cards import Card
from oysterbench.report.plots import Curve, broken, signed_plot, thin

TIME = "time since start [s]"
POSITION = ("x (east)", "y (north)", "z (up)")
UNKNOWN = ("x", "y", "z (up)")
"""Names of the axes if it is unknown where north is."""
ATTITUDE = ("roll", "pitch", "yaw")


def position_errors(result: SlamResult) -> Array:
    """Position errors (N, 3), m in `map`: matched estimate minus ground truth."""
    return np.asarray(result.estimate.positions - result.truth.positions, dtype=float)


def attitude_errors_deg(result: SlamResult) -> Array:
    """Attitude errors (N, 3), deg: the rotation vector from the true to the estimated body frame, in the true body's
    axes x forward (roll), y left (pitch), z up (yaw); its length is the angle between the two."""
    from_quat = scipy.spatial.transform.Rotation.from_quat
    between = from_quat(result.truth.quaternions).inv() * from_quat(result.estimate.quaternions)
    return np.asarray(between.as_rotvec(degrees=True), dtype=float)


def component_cards(
    truth: Trajectory, scored: Sequence[tuple[str, SlamResult]], styles: Mapping[str, int], north: bool
) -> tuple[tuple[Card, ...], tuple[Card, ...]]:
    """Two rows of three cards, for position and attitude. north: whether y is known to point north."""
    errors = {method: np.hstack((position_errors(of), attitude_errors_deg(of))) for method, of in scored}
    end_s = float(truth.stamps_ns[-1] - truth.stamps_ns[0]) * 1e-9
    cards = []
    for k, name in enumerate((*(POSITION if north else UNKNOWN), *ATTITUDE)):
        curves = []
        for method, result in scored:
            seconds = (result.stamps_ns - truth.stamps_ns[0]) * 1e-9
            drawn = broken(result.stamps_ns, seconds, errors[method][:, k])
            curves.append(thin(Curve(method, *drawn, styles[method])))
        kind, unit = ("Position", "m") if k < len(POSITION) else ("Attitude", "deg")
        title = f"{kind} error: {name}"
        cards.append(Card(title, signed_plot(curves, title, TIME, f"error [{unit}]", (0.0, end_s))))
    return tuple(cards[:3]), tuple(cards[3:])
