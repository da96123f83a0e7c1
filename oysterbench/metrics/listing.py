"""Table of all metrics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from oysterbench.core.errors import OptionError
from oysterbench.evaluate.metrics import TRACKS

if TYPE_CHECKING:
    import pandas as pd


def table(track: str | None = None) -> pd.DataFrame:
    """List every metric that a result may contain.

    Parameters
    ----------
    track : str, optional
        slam, segmentation, detection, density, steering or exploration; all by default.

    Returns
    -------
    pandas.DataFrame
        Indexed by track and key: heading, unit, better (higher, lower or empty), definition.

    Examples
    --------
    >>> import oysterbench
    >>> oysterbench.metrics.table("slam").loc[("slam", "ate_rmse_m"), "unit"]
    'm'
    """
    import pandas as pd

    if track is not None and track not in TRACKS:
        raise OptionError(f"track: expected one of {', '.join(TRACKS)}, got {track!r}")
    rows = [
        (name, key, metric.heading, metric.unit, metric.better, metric.definition)
        for name, known in TRACKS.items()
        if track in (None, name)
        for key, metric in known.metrics.items()
    ]
    found = pd.DataFrame(rows, columns=["track", "metric", "heading", "unit", "better", "definition"])
    return found.set_index(["track", "metric"])
