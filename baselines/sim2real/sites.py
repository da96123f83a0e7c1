"""Leave-one-site-out results: each site tested with networks trained on all others, which shows what rendered images
add where nobody has labelled anything yet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.streams import stream
from oysterbench.evaluate.statistics import LEAST_SEQUENCES, RESAMPLES, Interval, resampled_interval, too_few
from oysterbench.report.table import Column, Estimate, Table, TableRow
from oysterbench.results.records import ResultRecord
from oysterbench_baselines.sim2real.scoring import WHOLE
from oysterbench_baselines.sim2real.settings import REAL
from oysterbench_baselines.sim2real.table import block_sums, over_seeds, ratios

TITLE = "Each site tested on by what was trained on all others"


@dataclass(frozen=True)
class SiteRow:
    """Results of a kind of training, or of a trivial method.

    iou:  over the pixels of each site, mean of the seeds; mean: of the sites
    gain: in IoU at each site, against real images alone; mean_gain: mean over the sites, with its interval over blocks
          of neighbouring images within each site and over seeds; None where this row is real images alone or trivial
    """

    variant: str
    seeds: int
    iou: Mapping[str, float]
    mean: float
    ap50: float
    gain: Mapping[str, float]
    mean_gain: float | None = None
    interval: Interval | None = None


def site_rows(records: Mapping[str, Sequence[ResultRecord]], block: int) -> list[SiteRow]:
    """Rows from the records of each site, for the kinds of training that all sites have, trivial methods first."""
    whole: dict[str, dict[str, dict[int, ResultRecord]]] = {}
    for site, found in records.items():
        for record in found:
            if record.sequence == WHOLE:
                of_site = whole.setdefault(record.method, {}).setdefault(site, {})
                of_site[-1 if record.seed is None else record.seed] = record
    complete = {variant: by_site for variant, by_site in whole.items() if by_site.keys() == records.keys()}
    rows = [_row(variant, by_site, complete.get(REAL), block) for variant, by_site in complete.items()]
    return sorted(rows, key=lambda row: row.seeds > 0)


def _row(
    variant: str,
    by_site: Mapping[str, Mapping[int, ResultRecord]],
    base: Mapping[str, Mapping[int, ResultRecord]] | None,
    block: int,
) -> SiteRow:
    means = {
        key: {site: float(np.mean([r.metrics[key] for r in seeds.values()])) for site, seeds in by_site.items()}
        for key in ("iou", "ap50_mask")
    }
    each = [set(seeds) for seeds in by_site.values()]
    shared = each[0].intersection(*each[1:])
    iou, mean, ap50 = means["iou"], float(np.mean(list(means["iou"].values()))), means["ap50_mask"]
    count = sum(seed >= 0 for seed in shared)
    row = SiteRow(variant, count, iou, mean, float(np.mean(list(ap50.values()))), {})
    if base is not None:
        shared = shared.intersection(*base.values())
    if base is None or variant == REAL or not shared or not count:
        return row
    pairs = {
        site: tuple(np.array([block_sums(of[site][seed], block) for seed in sorted(shared)]) for of in (by_site, base))
        for site in by_site
    }
    gain = {site: float((ratios(a.sum(axis=1)) - ratios(b.sum(axis=1))).mean()) for site, (a, b) in pairs.items()}
    mean_gain = float(np.mean(list(gain.values())))
    return SiteRow(variant, count, iou, mean, row.ap50, gain, mean_gain, _interval(pairs, len(shared)))


def _interval(pairs: Mapping[str, tuple[Array, ...]], seeds: int) -> Interval:
    """Bootstrap interval of the mean gain over sites: resamples the blocks of each site, and the seeds, which are the
    same for all sites; its percentiles are those of as many values as the smallest site has blocks. None, with the
    reason, where these are too few."""
    fewest, site = min((mine.shape[1], site) for site, (mine, _) in pairs.items())
    if fewest < LEAST_SEQUENCES:
        return Interval(np.nan, np.nan, f"{site}: {too_few(fewest, 'block')}")
    total = np.zeros((RESAMPLES, seeds))
    for site, (mine, other) in pairs.items():
        blocks = mine.shape[1]
        rng = stream(0, b"", "sim2real", "blocks", site)
        drawn = rng.multinomial(blocks, np.full(blocks, 1 / blocks), RESAMPLES)
        total += ratios(np.einsum("rb,sbk->rsk", drawn, mine)) - ratios(np.einsum("rb,sbk->rsk", drawn, other))
    return resampled_interval(over_seeds(total) / len(pairs), fewest)


def sites_table(rows: Sequence[SiteRow], remarks: Sequence[str] = ()) -> Table:
    """Table of IoU and gain at each site, and their means; remarks: shown below it."""
    sites = list(rows[0].iou) if rows else []
    columns = (
        Column("training", "training"),
        Column("seeds", "seeds", kind="number"),
        *(Column(f"site_{k}", site) for k, site in enumerate(sites)),
        Column("iou", "mean IoU", kind="number", digits=3, better="higher"),
        Column("gain", "mean gain", kind="estimate", digits=3, signed=True),
        Column("ap50_mask", "AP50", kind="number", digits=3, better="higher"),
    )
    return Table(TITLE, columns, tuple(_cells(row, sites) for row in rows), tuple(remarks))


def _cells(row: SiteRow, sites: Sequence[str]) -> TableRow:
    unknown = Interval(float("nan"), float("nan"), "")
    of_sites = (f"{row.iou[site]:.3f}" + (f" ({row.gain[site]:+.3f})" if row.gain else "") for site in sites)
    gain = None if row.mean_gain is None else Estimate(row.mean_gain, row.interval or unknown)
    return TableRow((row.variant, row.seeds or None, *of_sites, row.mean, gain, row.ap50))
