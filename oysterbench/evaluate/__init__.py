"""Evaluators: each scores an estimate against the ground truth. What there is of a metric, in the folder of its track:

described    `metrics.py`: definition, unit, direction and heading of each; `../metric.py` says what a description is,
             and `../metrics.py` has those of all tracks (`find_metric`)
computed     slam: `computation.py`, and `pose_errors.py` for errors of poses; segmentation: `computation.py`, from the
             counts of `tally.py`; detection, density, steering: the other files, one for each kind of metric
collected    `../values.py`: values, the reasons for those that are missing, and notes
called       `scoring.py` or `clip.py`; as functions of arrays and files, in `oysterbench.metrics`
"""
