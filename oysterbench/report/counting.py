"""Files of a count in images: tables, a summary, annotations, a page."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oysterbench.core.atomic import appearing, write_atomically
from oysterbench.core.errors import LabelError
from oysterbench.counting.coco import coco_document, is_as_counted
from oysterbench.counting.measure import OysterRow, PictureCount
from oysterbench.counting.run import Counted
from oysterbench.counting.store import Store
from oysterbench.counting.survey import Survey
from oysterbench.report.counting_page import counting_page
from oysterbench.report.formats import csv_of
from oysterbench.report.renderers.csv import field

FORMAT = "oysterbench-counts/1"

PAGE, IMAGES, OYSTERS, SUMMARY, COCO = "index.html", "images.csv", "oysters.csv", "summary.json", "instances.json"


@dataclass(frozen=True)
class Making:
    """How counts were made, for the record: the command, the method's identity, the settings."""

    command: str
    identity: Mapping[str, Any]
    settings: Mapping[str, Any]


def check_folder(store: Store, with_coco: bool = False) -> None:
    """Raise LabelError where the count would overwrite files in the folder that are not from an earlier count, or may
    have been corrected since."""
    there = [name for name in _files(with_coco) if (store.folder / name).exists()]
    if there and not store.begun and FORMAT not in _text(store.folder / SUMMARY):
        raise LabelError(
            f"{store.folder}: the count would overwrite {', '.join(there)}, which no count has left there: give "
            "another folder by --out"
        )
    if with_coco and (path := store.folder / COCO).exists() and not is_as_counted(path):
        raise LabelError(
            f"{path}: --coco would overwrite it, though it was changed by hand or is of an earlier version: move it "
            "elsewhere first"
        )


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def write_counts(found: Survey, counted: Counted, store: Store, making: Making, with_coco: bool = False) -> list[Path]:
    """Write all files of the finished images and return their paths."""
    folder = store.folder
    summary = {"format": FORMAT, **found.as_plain(), "settings": making.settings, "made_of": making.identity}
    write_atomically(folder / IMAGES, csv_of(list(picture_rows(found))).encode())
    _write_oysters(folder / OYSTERS, store, found.pictures)
    write_atomically(folder / SUMMARY, (json.dumps(summary, indent=2, allow_nan=False) + "\n").encode())
    if with_coco:
        write_atomically(folder / COCO, (json.dumps(coco_document(store, found.pictures)) + "\n").encode())
    page = counting_page(found, counted.films, store, making.command, making.identity, making.settings, with_coco)
    write_atomically(folder / PAGE, page.encode())
    return [folder / name for name in _files(with_coco)]


def _files(with_coco: bool) -> list[str]:
    return [PAGE, IMAGES, OYSTERS, SUMMARY, *([COCO] if with_coco else [])]


def picture_rows(found: Survey) -> Iterator[dict[str, Any]]:
    """One row per image or frame, then one for each that could not be counted."""
    told = found.tells_state
    for one in found.pictures:
        yield {
            "image": one.name,
            "file": one.file,
            "frame": one.index,
            "time_s": _rounded(one.time_s, 3),
            "width_px": one.width,
            "height_px": one.height,
            "oysters": one.oysters,
            "cut_by_edge": one.cut,
            "too_small": one.small,
            "live": one.live if told else None,
            "dead": one.dead if told else None,
            "cover_percent": None if one.cover is None else round(100 * one.cover, 3),
            "area_m2": _rounded(one.area_m2, 6),
            "oysters_per_m2": _rounded(one.per_m2, 3),
            "mean_length_mm": _rounded(one.length_mm, 2),
            "novelty": _rounded(one.novelty, 3),
            "unlike": None if one.novelty is None else "yes" if one.unlike else "no",
            "failure": None,
        }
    for name, why in found.failures.items():
        yield {"image": name, "failure": why}


OYSTER_COLUMNS = (
    "image",
    "time_s",
    "number",
    "counted",
    "cut_by_edge",
    "too_small",
    "left_px",
    "top_px",
    "width_px",
    "height_px",
    "area_px",
    "score",
    "live",
    "state",
    "length_mm",
    "width_mm",
)


def oyster_row(picture: PictureCount, row: OysterRow) -> tuple[Any, ...]:
    """Row of an oyster, in the order of `OYSTER_COLUMNS`."""
    return (
        picture.name,
        _rounded(picture.time_s, 3),
        row.number,
        "yes" if row.counted else "no",
        "yes" if row.cut else "no",
        "yes" if row.small else "no",
        *(round(value, 2) for value in row.box),
        row.area_px,
        _rounded(row.score, 4),
        _rounded(row.live, 4),
        row.state,
        _rounded(row.length_mm, 2),
        _rounded(row.width_mm, 2),
    )


def _write_oysters(path: Path, store: Store, pictures: Sequence[PictureCount]) -> None:
    """Write the oysters image by image: a long video has too many to hold in memory."""
    with appearing(path) as file:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        lines = csv.writer(text, lineterminator="\n")
        lines.writerow(OYSTER_COLUMNS)
        for one in pictures:
            lines.writerows(map(field, oyster_row(one, row)) for row in store.oysters(one.name))
        text.flush()
        text.detach()


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
