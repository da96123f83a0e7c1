"""The table of distances, and a sheet of rendered images beside the real ones that resemble them most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from oysterbench.evaluate.statistics import Interval
from oysterbench.report.table import Cell, Column, Estimate, Table, TableRow
from oysterbench.results.records import dump, plain
from oysterbench.simulation.gallery import sheet
from oysterbench_baselines.realism.distance import kid_between, kid_within
from oysterbench_baselines.realism.features import FeatureSet, Picture

ROWS = 8
"""Number of rendered images of each set on the sheet."""
NEAREST = 3
"""Number of real images beside each."""
WITHIN = Interval(np.nan, np.nan, "between the halves of one set")


def distances(synthetic: Sequence[FeatureSet], real: Sequence[FeatureSet]) -> list[dict[str, Any]]:
    """Compute a line for each pair of a set and a real set: names, number of images, KID and its interval. A real set
    and itself: KID between its two halves."""
    lines = []
    for kind, sets in (("synthetic", synthetic), ("real", real)):
        for one in sets:
            for other in real:
                if one is other:
                    value, interval = kid_within(one.features, one.blocks), WITHIN
                else:
                    value, interval = kid_between(one.features, other.features, one.blocks, other.blocks)
                lines.append(
                    {
                        "kind": kind,
                        "set": one.name,
                        "images": len(one.names),
                        "real": other.name,
                        "kid": value,
                        "interval": interval,
                    }
                )
    return lines


def document(lines: Sequence[dict[str, Any]]) -> str:
    """JSON text of the lines; an interval that does not exist is null, with the reason beside it."""
    return dump(plain([{**line, "interval": asdict(line["interval"])} for line in lines])) + "\n"


def table_of(lines: Sequence[dict[str, Any]]) -> Table:
    """Table with a row for each set and a column for each real set."""
    real = list(dict.fromkeys(line["real"] for line in lines))
    columns = [Column("set", "Images"), Column("kind", "Kind"), Column("images", "Number", kind="number")]
    columns += [Column(name, f"KID to {name}", kind="estimate", digits=3, better="lower") for name in real]
    rows = []
    for name, kind in dict.fromkeys((line["set"], line["kind"]) for line in lines):
        own = [line for line in lines if (line["set"], line["kind"]) == (name, kind)]
        cells = [
            Cell(value=Estimate(line["kid"], line["interval"]), kind="soft" if kind == "real" else "") for line in own
        ]
        rows.append(TableRow((name, kind, own[0]["images"], *cells)))
    notes = (
        "Squared kernel distance of the features of an EfficientNet-Lite0, without bias; 95 % intervals over blocks of "
        "neighbouring images. A real set and itself: its first half and its last.",
    )
    return Table("How far images are from real ones", tuple(columns), tuple(rows), notes)


def neighbours(synthetic: Sequence[FeatureSet], real: Sequence[FeatureSet]) -> Picture:
    """Sheet with rows of a rendered image and the real ones whose features are nearest, by cosine similarity."""
    features = np.concatenate([one.features for one in real])
    pictures = [picture for one in real for picture in one.pictures]
    names = [name for one in real for name in one.names]
    features = features / np.linalg.norm(features, axis=1, keepdims=True)
    shown, captions = [], []
    for one in synthetic:
        for k in np.unique(np.linspace(0, len(one.names) - 1, ROWS).round().astype(int)).tolist():
            alike = features @ (one.features[k] / np.linalg.norm(one.features[k]))
            nearest = np.argsort(-alike, kind="stable")[:NEAREST].tolist()
            nearest += [nearest[-1]] * (NEAREST - len(nearest))
            shown += [one.pictures[k], *(pictures[n] for n in nearest)]
            captions += [f"{one.name}: {one.names[k]}"[-34:], *(f"{names[n]} {alike[n]:.2f}" for n in nearest)]
    return sheet(shown, captions, 1 + NEAREST)
