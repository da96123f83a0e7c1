"""What is measured of maps of oysters: name, unit, direction and definition of every metric."""

from __future__ import annotations

from oysterbench.evaluate.metric import Metric, TrackMetrics

PER_M2 = "per m\N{SUPERSCRIPT TWO}"
_SHOWN = "those on the ground that was seen that some picture shows, with the true poses"

DENSITY: dict[str, Metric] = {
    "map_score": Metric(
        "",
        "higher",
        "Mean over the cells that were truly seen of 1 / (1 + e / 15), e the error of live oysters per square metre: "
        "an error of the restoration threshold counts half, and a cell without a number counts 0.",
        "Score",
        column=("score", ""),
        small=0.0,
    ),
    "cell_mae_per_m2": Metric(
        PER_M2,
        "lower",
        "Mean absolute error of live oysters per square metre over the cells that were truly seen and have a number.",
        "MAE",
        column=("MAE", "per m²"),
        digits=1,
        small=0.0,
    ),
    "cell_bias_per_m2": Metric(
        PER_M2,
        "",
        "Mean of that error over the same cells: above 0 where too many are counted.",
        "Bias",
        column=("bias", "per m²"),
        digits=1,
        small=0.0,
    ),
    "right_class": Metric(
        "",
        "higher",
        "Share (0 to 1) of the cells that were truly seen whose restoration class (below 15, 15 to 50, 50 and more "
        "live oysters per square metre) is the true one; a cell without a number is wrong.",
        "Right class",
        column=("class", "% right"),
        factor=100.0,
        digits=0,
        small=0.0,
    ),
    "coverage": Metric(
        "",
        "higher",
        "Share (0 to 1) of the cells that were truly seen to which the map gives a number.",
        "Coverage",
        column=("cover", "%"),
        factor=100.0,
        digits=2,
    ),
    "count_error_percent": Metric(
        "%",
        "",
        f"Counted less true oysters, live and dead, by the true ones: {_SHOWN}.",
        "Count error",
        column=("count", "% error"),
        digits=1,
        small=0.0,
    ),
    "count_off_percent": Metric("%", "lower", "Size of that error.", "Count off"),
    "live_error_percent": Metric(
        "%", "", "The same error of the live ones alone.", "Live error", column=("live", "% error"), digits=1, small=0.0
    ),
    "count_within": Metric("", "", "1 where the interval of the count holds the true one, 0 where not.", "In interval"),
    "twice_percent": Metric(
        "%",
        "lower",
        "Entries of the map that show an oyster that another entry shows, by the true oysters.",
        "Twice",
        column=("twice", "%"),
        digits=1,
        small=0.0,
    ),
    "lost_percent": Metric(
        "%",
        "lower",
        "Oysters that were found in a picture and have no entry of their own, as they were taken for others, by the "
        "true oysters.",
        "Lost",
        column=("lost", "%"),
        digits=1,
        small=0.0,
    ),
    "oysters_truth": Metric("", "", f"True oysters: {_SHOWN}.", "True"),
    "oysters_counted": Metric("", "", "Oysters of the map; one that the edge cuts in every picture is a half.", "Map"),
    "hidden_percent": Metric(
        "%",
        "",
        "Oysters on the ground that was seen that no picture shows, as others lie on them, by all there: no map of "
        "pictures counts them.",
        "Hidden",
    ),
    "area_m2": Metric("m\N{SUPERSCRIPT TWO}", "", "Ground that was truly seen.", "Seen"),
    "density_truth_live_per_m2": Metric(PER_M2, "", "True live oysters by the ground that was seen.", "True density"),
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
