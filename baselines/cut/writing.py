"""Writes translated images as a folder of masks, with the measurements of each image in `drift.csv`."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from oysterbench.annotations import LabelledImage, LabelledSet, remove_image, write_folder
from oysterbench.annotations.folders import LAYERS
from oysterbench.annotations.manifest import FILE as MANIFEST
from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import MethodError
from oysterbench_baselines.cut.drift import Drift, mask_drift
from oysterbench_baselines.cut.judge import Judge, Verdict, together

FILE = "drift.csv"
JUDGED = ("iou", "iou_after", "vanished", "appeared")
"""Columns of `FILE` in addition to those of a Drift: the shares of a Verdict."""


@dataclass(frozen=True)
class Measured:
    """Measurements of one image; verdict: None without a judge; written: whether it is in the folder."""

    name: str
    drift: Drift
    verdict: Verdict | None
    written: bool


def write_translated(
    source: LabelledSet,
    change: Callable[[LabelledSet], Iterator[LabelledImage]],
    out: Path,
    judge: Judge | None,
    share: float,
    progress: Callable[[int, int], None],
) -> list[Measured]:
    """Write the images that `change` returns into `out`, and the measurements of each into `FILE` there.

    share: images on which the judge's IoU falls below this share of its former value are left out; 0 keeps all. Images
    stay on their sides of a split. Raises MethodError where none is left, and, before anything is read, where `out`
    holds other images than an earlier translation, or only some images have a side.
    """
    check_out(source, out)
    splits = _sides(source)
    found: list[Measured] = []

    def kept() -> Iterator[LabelledImage]:
        for before, after in zip(source, change(source), strict=True):
            verdict = None if judge is None else judge.verdict(before, after)
            drift = mask_drift(before.pixels, after.pixels, before.oysters)
            if not found:  # measurements of images that are written over; and by the file one may write here again
                write_atomically(out / FILE, _table([]).encode())
            found.append(Measured(before.name, drift, verdict, verdict is None or verdict.holds(share)))
            if found[-1].written:
                yield after
            else:
                remove_image(out, after.name)  # an earlier translation may have left it there
            progress(len(found), len(source))

    number = write_folder(kept(), out, splits)
    write_atomically(out / FILE, _table(found).encode())
    if not number:
        raise MethodError(
            f"{out}: on all {len(found)} images the judge's IoU fell below {share:g} of what it was, so none was "
            f"written; {FILE} there has the numbers: lower --keep, or translate less"
        )
    return found


def check_out(source: LabelledSet, out: Path) -> None:
    """Raise MethodError where a folder to write holds images that are not of an earlier translation, or some that are
    to be translated."""
    there = [name for name in (*LAYERS, MANIFEST) if (out / name).exists()]
    if there and not (out / FILE).is_file():
        raise MethodError(
            f"{out}: expected a new folder, or that of an earlier translation, with {FILE}, got one with "
            f"{', '.join(there)}, which was left unchanged; choose another --out"
        )
    for path in sorted({file for entry in source.entries for file in entry.files}):
        if path.resolve().is_relative_to(out.resolve()):
            raise MethodError(
                f"{out}: holds {path.name}, which is to be translated; it was left unchanged: choose another --out"
            )


def _sides(source: LabelledSet) -> dict[str, str]:
    """Side of each image by its name; empty where there are no sides. Raises MethodError where only some have one."""
    splits = {entry.name: entry.split for entry in source.entries if entry.split}
    if splits and len(splits) < len(source):
        name = next(entry.name for entry in source.entries if not entry.split)
        raise MethodError(
            f"{source.name}: expected a side of a split for every image or for none, got none for {name}, and "
            f"{', '.join(source.splits)} for others: translate sources with sides and those without into folders of "
            "their own"
        )
    return splits


def sentences(found: list[Measured]) -> Iterator[str]:
    """Yield sentences that summarise the measurements, for the terminal."""
    rows = np.array([[getattr(one.drift, key.name) for key in fields(Drift)] for one in found], dtype=float)
    known = rows[~np.isnan(rows).any(axis=1)]
    if len(known):
        edges, kept, flow, offset = np.median(known, axis=0)
        yield (
            f"mask drift, medians of {len(known)} images: edges correlate {edges:.2f}, {100 * kept:.0f} % of the "
            f"strongest are kept, flow {flow:.1f} px, best offset {offset:.0f} px"
        )
    if verdicts := [one.verdict for one in found if one.verdict is not None]:
        whole = together(verdicts)
        yield (
            f"the judge, over {len(verdicts)} images: IoU with the labels {whole.iou:.3f} before and "
            f"{whole.iou_after:.3f} after; {100 * whole.vanished_share:.1f} % of the oyster that it recognised has "
            f"vanished, {100 * whole.appeared_share:.1f} % of the rest now looks like oyster"
        )
    if left_out := sum(not one.written for one in found):
        yield f"left out: {left_out} of {len(found)} images, on which it no longer finds the labels"


def _table(found: list[Measured]) -> str:
    text = io.StringIO()
    keys = [key.name for key in fields(Drift)]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["id", *keys, *JUDGED, "written"])
    for one in found:
        seen = one.verdict
        judged = [None] * 4 if seen is None else [seen.iou, seen.iou_after, seen.vanished_share, seen.appeared_share]
        numbers = [*(getattr(one.drift, key) for key in keys), *judged]
        told = ["" if value is None or np.isnan(value) else f"{value:.4f}" for value in numbers]
        writer.writerow([one.name.replace("/", "-"), *told, int(one.written)])
    return text.getvalue()
