"""The table: each kind of training averaged over its seeds, with intervals, and compared with the same training without
synthetic images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.streams import stream
from oysterbench.evaluate.statistics import Interval, resample_counts, resampled_interval, too_few
from oysterbench.results.records import ResultRecord
from oysterbench_baselines.sim2real.scoring import WHOLE
from oysterbench_baselines.sim2real.settings import REAL

MEANS = ("ap_mask", "ap50_mask", "count_mae", "count_bias", "boundary_iou", "precision", "recall")


@dataclass(frozen=True)
class VariantRow:
    """Results of one kind of training, or of a trivial method.

    size:     number of real images requested: None for none, 0 for all; images: how many there were
    iou:      over all test pixels, mean of the seeds; its interval is over seeds and blocks of neighbouring test images
    by_clip:  IoU of each test clip, mean of the seeds; spread: smallest and largest IoU of a seed
    means:    further metrics (`MEANS`), mean of the seeds
    gain:     in IoU, against the same number of real images alone, with the paired interval; None where there is no
              such row, or it is this one
    """

    variant: str
    size: int | None
    images: int
    seeds: tuple[int, ...]
    iou: float
    interval: Interval
    spread: tuple[float, float]
    by_clip: Mapping[str, float]
    means: Mapping[str, float]
    gain: float | None = None
    gain_interval: Interval | None = None


def variants(records: Sequence[ResultRecord], block: int) -> list[VariantRow]:
    """Rows of all cells in the records, trivial methods first. block: neighbouring images that are resampled together.

    The interval is over the test images, as another survey would change them, and over the seeds, which draw other real
    images to train on. A gain is over the seeds that both rows have.
    """
    groups: dict[tuple[str, int | None], list[ResultRecord]] = {}
    for record in records:
        groups.setdefault((record.method, record.method_settings.get("asked")), []).append(record)
    rows = []
    for (variant, size), group in groups.items():
        whole = _by_seed(group)
        base = groups.get((REAL, size))
        gain = None
        if size is not None and variant != REAL and base is not None:
            gain = _gain(whole, _by_seed(base), block)
        rows.append(_row(variant, size, group, whole, block, gain))
    order = {variant: k for k, variant in enumerate(dict.fromkeys(row.variant for row in rows))}
    return sorted(rows, key=lambda row: (row.seeds != (), row.size is not None, row.images, order[row.variant]))


def _by_seed(group: Sequence[ResultRecord]) -> dict[int, ResultRecord]:
    return {-1 if record.seed is None else record.seed: record for record in group if record.sequence == WHOLE}


def _row(
    variant: str,
    size: int | None,
    group: Sequence[ResultRecord],
    whole: Mapping[int, ResultRecord],
    block: int,
    gain: tuple[float, Interval] | None,
) -> VariantRow:
    sums = np.array([block_sums(record, block) for _, record in sorted(whole.items())])
    each = ratios(sums.sum(axis=1))
    clips = dict.fromkeys(record.sequence for record in group if record.sequence != WHOLE)
    first = next(iter(whole.values()))
    return VariantRow(
        variant,
        size,
        int(first.method_settings.get("real_images", 0)),
        tuple(sorted(seed for seed in whole if seed >= 0)),
        float(each.mean()),
        _interval(sums, None),
        (float(each.min()), float(each.max())),
        {clip: float(np.mean([r.metrics["iou"] for r in group if r.sequence == clip])) for clip in clips},
        {key: float(np.mean([record.metrics[key] for record in whole.values()])) for key in MEANS},
        *(gain or (None, None)),
    )


def _gain(
    one: Mapping[int, ResultRecord], base: Mapping[int, ResultRecord], block: int
) -> tuple[float, Interval] | None:
    shared = sorted(set(one) & set(base))
    if not shared:
        return None
    mine, other = (np.array([block_sums(group[seed], block) for seed in shared]) for group in (one, base))
    difference = ratios(mine.sum(axis=1)) - ratios(other.sum(axis=1))
    return float(difference.mean()), _interval(mine, other)


def block_sums(record: ResultRecord, block: int) -> Array:
    """True positive px and px of the union (B, 2) in a record, for blocks of neighbouring images of a clip."""
    lines: Sequence[Mapping[str, Any]] = record.info["images"]
    rows = []
    for clip in dict.fromkeys(line["clip"] for line in lines):
        own = np.array(
            [
                [line["true_positive"], line["true_positive"] + line["false_positive"] + line["false_negative"]]
                for line in lines
                if line["clip"] == clip
            ],
            dtype=float,
        )
        # As many blocks as whole ones would fit, so that none is much smaller than the others.
        rows += [part.sum(axis=0) for part in np.array_split(own, max(1, len(own) // block))]
    return np.array(rows)


def ratios(sums: Array) -> Array:
    """IoU of (..., 2) sums; 1 where there is nothing to find and nothing was found."""
    return np.where(sums[..., 1] > 0, sums[..., 0] / np.maximum(sums[..., 1], 1), 1.0)


def _interval(sums: Array, other: Array | None) -> Interval:
    """Interval of the mean IoU over seeds from sums (S, B, 2), minus that of `other` where given: resamples the blocks,
    and the seeds, which are the same for both."""
    blocks = sums.shape[1]
    drawn = resample_counts(blocks)
    if drawn is None:
        return Interval(np.nan, np.nan, too_few(blocks, "block"))
    values = ratios(np.einsum("rb,sbk->rsk", drawn, sums))
    if other is not None:
        values = values - ratios(np.einsum("rb,sbk->rsk", drawn, other))
    return resampled_interval(over_seeds(values), blocks)


def over_seeds(values: Array) -> Array:
    """Means (R,) of values (R, S) over as many of their S seeds, drawn anew with replacement for each resample R."""
    resamples, seeds = values.shape
    chosen = stream(0, b"", "sim2real", "seeds").integers(0, seeds, (resamples, seeds))
    return np.asarray(np.take_along_axis(values, chosen, axis=1).mean(axis=1))
