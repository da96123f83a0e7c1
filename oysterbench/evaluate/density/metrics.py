"""What is measured of maps of oysters: name, unit, direction and definition of every metric."""

from __future__ import annotations

from oysterbench.evaluate.metric import Column, Metric, TrackMetrics

PER_M2 = "per m\N{SUPERSCRIPT TWO}"
_SHOWN = "those on the ground that was seen that some picture shows, with the true poses"

DENSITY: dict[str, Metric] = {
    "map_score": Metric(
        "Mean over the cells that were truly seen of 1 / (1 + e / 15), e the error of live oysters per square metre: "
        "an error of the restoration threshold counts half, and a cell without a number counts 0.",
        "Score",
        better="higher",
        column=Column("score", "", small=0.0),
    ),
    "cell_mae_per_m2": Metric(
        "Mean absolute error of live oysters per square metre over the cells that were truly seen and have a number.",
        "MAE",
        unit=PER_M2,
        better="lower",
        column=Column("MAE", "per m²", digits=1, small=0.0),
    ),
    "cell_bias_per_m2": Metric(
        "Mean of that error over the same cells: above 0 where too many are counted.",
        "Bias",
        unit=PER_M2,
        column=Column("bias", "per m²", digits=1, small=0.0),
    ),
    "right_class": Metric(
        "Share (0 to 1) of the cells that were truly seen whose restoration class (below 15, 15 to 50, 50 and more "
        "live oysters per square metre) is the true one; a cell without a number is wrong.",
        "Right class",
        better="higher",
        column=Column("class", "% right", digits=0, small=0.0, factor=100.0),
    ),
    "coverage": Metric(
        "Share (0 to 1) of the cells that were truly seen to which the map gives a number.",
        "Coverage",
        better="higher",
        column=Column("cover", "%", digits=1, small=0.0, factor=100.0),
    ),
    "count_error_percent": Metric(
        f"Counted less true oysters, live and dead, by the true ones: {_SHOWN}.",
        "Count error",
        unit="%",
        column=Column("count", "% error", digits=1, small=0.0),
    ),
    "count_off_percent": Metric("Size of that error.", "Count off", unit="%", better="lower"),
    "live_error_percent": Metric(
        "The same error of the live ones alone.",
        "Live error",
        unit="%",
        column=Column("live", "% error", digits=1, small=0.0),
    ),
    "count_within": Metric("1 where the interval of the count holds the true one, 0 where not.", "In interval"),
    "twice_percent": Metric(
        "Entries of the map that show an oyster that another entry shows, by the true oysters.",
        "Twice",
        unit="%",
        better="lower",
        column=Column("twice", "%", digits=1, small=0.0),
    ),
    "lost_percent": Metric(
        "Oysters that were found in a picture and have no entry of their own, as they were taken for others, by the "
        "true oysters.",
        "Lost",
        unit="%",
        better="lower",
        column=Column("lost", "%", digits=1, small=0.0),
    ),
    "oysters_truth": Metric(f"True oysters: {_SHOWN}.", "True"),
    "oysters_counted": Metric("Oysters of the map; one that the edge cuts in every picture is a half.", "Map"),
    "hidden_percent": Metric(
        "Oysters on the ground that was seen that no picture shows, as others lie on them, by all there: no map of "
        "pictures counts them.",
        "Hidden",
        unit="%",
    ),
    "area_m2": Metric("Ground that was truly seen.", "Seen", unit="m\N{SUPERSCRIPT TWO}"),
    "density_truth_live_per_m2": Metric("True live oysters by the ground that was seen.", "True density", unit=PER_M2),
}
"""Metrics of the density track by their key."""

TABLE = (
    "map_score",
    "count_error_percent",
    "live_error_percent",
    "cell_mae_per_m2",
    "cell_bias_per_m2",
    "right_class",
    "twice_percent",
    "lost_percent",
    "coverage",
)
TRACK = TrackMetrics(
    DENSITY, TABLE, TABLE[1:], beside="cell_mae_per_m2", failed={"map_score": 0.0, "right_class": 0.0, "coverage": 0.0}
)
