"""What is measured of maps of oysters: name, unit, direction and definition of every metric."""

from __future__ import annotations

from oysterbench.evaluate.metric import Column, Metric, TrackMetrics, higher, lower, neutral

PER_M2 = "per m\N{SUPERSCRIPT TWO}"
_SHOWN = "those on the ground that was seen that some picture shows, with the true poses"

DENSITY: dict[str, Metric] = {
    "map_score": higher("Score", column=Column("score"))(
        "Mean over the cells that were truly seen of 1 / (1 + e / 15), e the error of live oysters per square metre: "
        "an error of the restoration threshold counts half, and a cell without a number counts 0."
    ),
    "cell_mae_per_m2": lower("MAE", PER_M2, Column("MAE", "per m²", 1))(
        "Mean absolute error of live oysters per square metre over the cells that were truly seen and have a number."
    ),
    "cell_bias_per_m2": neutral("Bias", PER_M2, Column("bias", "per m²", 1))(
        "Mean of that error over the same cells: above 0 where too many are counted."
    ),
    "right_class": higher("Right class", column=Column("class", "% right", 0, factor=100.0))(
        "Share (0 to 1) of the cells that were truly seen whose restoration class (below 15, 15 to 50, 50 and more "
        "live oysters per square metre) is the true one; a cell without a number is wrong."
    ),
    "coverage": higher("Coverage", column=Column("cover", "%", 1, factor=100.0))(
        "Share (0 to 1) of the cells that were truly seen to which the map gives a number."
    ),
    "count_error_percent": neutral("Count error", "%", Column("count", "% error", 1))(
        f"Counted less true oysters, live and dead, by the true ones: {_SHOWN}."
    ),
    "count_off_percent": lower("Count off", "%")("Size of that error."),
    "live_error_percent": neutral("Live error", "%", Column("live", "% error", 1))(
        "The same error of the live ones alone."
    ),
    "count_within": neutral("In interval")("1 where the interval of the count holds the true one, 0 where not."),
    "twice_percent": lower("Twice", "%", Column("twice", "%", 1))(
        "Entries of the map that show an oyster that another entry shows, by the true oysters."
    ),
    "lost_percent": lower("Lost", "%", Column("lost", "%", 1))(
        "Oysters that were found in a picture and have no entry of their own, as they were taken for others, by the "
        "true oysters."
    ),
    "oysters_truth": neutral("True")(f"True oysters: {_SHOWN}."),
    "oysters_counted": neutral("Map")("Oysters of the map; one that the edge cuts in every picture is a half."),
    "hidden_percent": neutral("Hidden", "%")(
        "Oysters on the ground that was seen that no picture shows, as others lie on them, by all there: no map of "
        "pictures counts them."
    ),
    "area_m2": neutral("Seen", "m\N{SUPERSCRIPT TWO}")("Ground that was truly seen."),
    "density_truth_live_per_m2": neutral("True density", PER_M2)("True live oysters by the ground that was seen."),
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
    "Oyster maps",
    DENSITY,
    TABLE,
    TABLE[1:],
    beside="cell_mae_per_m2",
    failed={"map_score": 0.0, "right_class": 0.0, "coverage": 0.0},
)
