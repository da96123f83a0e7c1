"""Metrics of oyster maps: name, unit, direction and definition of each."""

from __future__ import annotations

from oysterbench.evaluate.metric import Column, Metric, TrackMetrics, counted, higher, lower, neutral

PER_M2 = "per m\N{SUPERSCRIPT TWO}"
_SHOWN = "the oysters on the seen ground that some image shows, by the true poses"

DENSITY: dict[str, Metric] = {
    "map_score": higher("Score", column=Column("score"))(
        "Live oysters that the map and the true one have in common, relative to those that either has: with their "
        "densities in each truly seen cell, the sum of the lower ones over that of the higher ones, by seen area "
        "(Ruzicka similarity, or weighted Jaccard index). A cell without a number has none. 1 for the true map, 0 for "
        "an empty one, a half for one of half the ground, or with twice the oysters."
    ),
    "cell_mae_per_m2": lower("MAE", PER_M2, Column("MAE", "per m²", 1))(
        "Mean absolute error of live oysters per square metre over the truly seen cells that have a number."
    ),
    "cell_bias_per_m2": neutral("Bias", PER_M2, Column("bias", "per m²", 1))(
        "Mean of the signed error over the same cells: above 0 for overcounting."
    ),
    "right_class": higher("Right class", column=Column("class", "% right", 0, factor=100.0))(
        "Share (0 to 1) of the truly seen cells whose restoration class (below 15, 15 to 50, 50 and more "
        "live oysters per square metre) is the true one; a cell without a number is wrong."
    ),
    "coverage": higher("Coverage", column=Column("cover", "%", 1, factor=100.0))(
        "Share (0 to 1) of the truly seen cells to which the map gives a number."
    ),
    "count_error_percent": neutral("Count error", "%", Column("count", "% error", 1))(
        f"Counted minus true oysters, live and dead, relative to the true ones: {_SHOWN}."
    ),
    "count_off_percent": lower("Count off", "%")("Absolute value of that error."),
    "live_error_percent": neutral("Live error", "%", Column("live", "% error", 1))(
        "The same error for live oysters only."
    ),
    "count_within": neutral("In interval")("1 if the interval of the count contains the true count, else 0."),
    "twice_percent": lower("Twice", "%", Column("twice", "%", 1))(
        "Map entries that show an oyster that another entry also shows, relative to the true oysters."
    ),
    "lost_percent": lower("Lost", "%", Column("lost", "%", 1))(
        "Oysters found in an image but without their own entry, because they were merged with others, relative to the "
        "true oysters."
    ),
    "oysters_truth": counted("True")(f"True oysters: {_SHOWN}."),
    "oysters_counted": counted("Map")("Oysters of the map; one that the edge cuts in every image counts as half."),
    "hidden_percent": neutral("Hidden", "%")(
        "Share of the oysters on the seen ground that no image shows, because others lie on them: no map from images "
        "counts them."
    ),
    "area_m2": neutral("Seen", "m\N{SUPERSCRIPT TWO}")("Area of ground truly seen."),
    "density_truth_live_per_m2": neutral("True density", PER_M2)("True live oysters per area of seen ground."),
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
