"""Metrics as functions of files, arrays or poses, which return plain Python numbers.

They are computed by the evaluators: `ate(truth, estimate)` is the `ate_rmse_m` of a result, to the last digit.
`table()` lists all metrics that a result may contain.

>>> import oysterbench
>>> oysterbench.metrics.count_mae([12, 7], [11, 9])
1.5

trajectories    ate, ate_rotation, rpe, rpe_rotation, drift, velocity_error, scale_error, coverage, trajectory_score
masks           iou, dice, precision, recall, boundary_iou, image_iou
single oysters  average_precision, average_recall, panoptic_quality, count_mae, count_rmse, count_bias
steering        oysterbench.metrics.steering: accuracy, balanced_accuracy, macro_f1, skill, ...
over sequences  summarise (mean with interval), compare (which method is better)
"""

from oysterbench.evaluate.statistics import compare, summarise
from oysterbench.evaluate.steering import labels as steering
from oysterbench.metrics.instances import (
    average_precision,
    average_recall,
    count_bias,
    count_mae,
    count_rmse,
    panoptic_quality,
)
from oysterbench.metrics.listing import table
from oysterbench.metrics.masks import boundary_iou, dice, image_iou, iou, precision, recall
from oysterbench.metrics.trajectories import (
    ate,
    ate_rotation,
    coverage,
    drift,
    rpe,
    rpe_rotation,
    scale_error,
    trajectory_score,
    velocity_error,
)

__all__ = [
    "ate",
    "ate_rotation",
    "average_precision",
    "average_recall",
    "boundary_iou",
    "compare",
    "count_bias",
    "count_mae",
    "count_rmse",
    "coverage",
    "dice",
    "drift",
    "image_iou",
    "iou",
    "panoptic_quality",
    "precision",
    "recall",
    "rpe",
    "rpe_rotation",
    "scale_error",
    "steering",
    "summarise",
    "table",
    "trajectory_score",
    "velocity_error",
]
