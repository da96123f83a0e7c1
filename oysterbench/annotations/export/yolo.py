"""YOLO: data.yaml, images/PART/ and labels/PART/, once with polygons (segment/) and once with boxes (detect/).

One class, oyster. A line is `0 x1 y1 x2 y2 ...`, or `0 x y width height` about the centre, in fractions of width and
height. An oyster that others divide into pieces is one polygon, whose pieces are joined by slits of zero width.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.export.examples import Example, Parts, examples
from oysterbench.annotations.image import Entry
from oysterbench.annotations.manifest import TRAIN, VAL
from oysterbench.annotations.runs import ends_of, runs_of, taken_of
from oysterbench.annotations.yolo import DETECT, SEGMENT
from oysterbench.core.disk_space import link
from oysterbench.core.geometry import Array
from oysterbench.core.polygons import mask_polygons
from oysterbench.core.streams import stream
from oysterbench.recipe import OYSTER

VAL_SHARE = 0.2  # of the clips, if no set for validation was given
DIGITS = 7  # of a fraction: a hundredth of a pixel in images of 100 000 px


def write(name: str, parts: Parts, folder: Path, step: Callable[[], None]) -> list[str]:
    """Write both folders; an image is one file under two names (a hard link) if the file system supports that."""
    parts, notes = with_val(parts)
    ignored = 0
    for part, entries in parts.items():
        for task in (SEGMENT, DETECT):
            (folder / task / "images" / part).mkdir(parents=True)
            (folder / task / "labels" / part).mkdir(parents=True)
        for example in examples(entries):
            file = f"{example.key}.{example.suffix}"
            picture = folder / SEGMENT / "images" / part / file
            picture.write_bytes(example.data)
            link(str(picture), str(folder / DETECT / "images" / part / file))
            for task, line in ((SEGMENT, _polygon), (DETECT, _box)):
                text = "".join(f"{line(mask)}\n" for mask in oyster_masks(example))
                (folder / task / "labels" / part / f"{example.key}.txt").write_text(text, encoding="utf-8")
            ignored += bool((example.image.ignore & example.image.oysters).any())
            step()
    for task in (SEGMENT, DETECT):
        (folder / task / "data.yaml").write_text(_data(name, task, parts), encoding="utf-8")
    if TRAIN not in parts:
        notes.append(
            f"no image is of a side {TRAIN}: data.yaml names images/{TRAIN} all the same, as YOLO requires, and is for "
            "validation alone"
        )
    counts = ", ".join(f"{len(entries)} {part}" for part, entries in parts.items())
    if ignored:
        notes.append(
            f"{ignored} images show oysters too small or too hidden to be counted, which have no label: YOLO has no "
            "place for what is to be ignored"
        )
    return [f"{counts}; class 0 is oyster", *notes]


def with_val(parts: Parts) -> tuple[Parts, list[str]]:
    """Return the parts with one for validation, and notes about it. If there is none, it takes whole clips of train; of
    the only clip, each camera's last images; and of images whose clips are not known, the last ones (`runs_of`). Clips
    are drawn by their names, so that the same clips give the same parts."""
    if VAL in parts or TRAIN not in parts:
        return parts, []
    entries = parts[TRAIN]
    runs = runs_of(entries)
    held: list[Entry] = []
    notes = []
    known = {run.entries[0].clip: run.entries for run in runs if run.known}
    if len(known) > 1:
        clips = sorted(known)
        order = stream(0, b"", "export", "val", *clips).permutation(len(clips))
        chosen = sorted(clips[k] for k in order[: max(1, round(VAL_SHARE * len(clips)))])
        held += [entry for clip in chosen for entry in known[clip]]
        notes.append(f"val is {len(chosen)} of {len(clips)} clips of train: {', '.join(chosen[:8])}")
    for only in known.values() if len(known) == 1 else ():
        held += _end_of(only)
        notes.append("val is the end of the only clip, which resembles the rest of it; another split (-val) says more")
    if unknown := [run.entries for run in runs if not run.known]:
        ends = [entry for run in unknown for entry in ends_of(run, VAL_SHARE)]
        ends = ends or [max((entry for run in unknown for entry in run), key=lambda entry: entry.name)]
        held += ends
        count = _count(unknown, {entry.name for entry in ends})
        which = f"the last {len(ends)} by name" if count == 1 else f"the ends of {count} runs, {len(ends)} images"
        notes.append(
            f"which images are of one clip is not known: val is {which}, and may show the same ground as train; a "
            "column clip in manifest.csv keeps clips together"
        )
    taken = {entry.name for entry in held}
    held = [entry for entry in entries if entry.name in taken]
    kept = [entry for entry in entries if entry.name not in taken]
    return {TRAIN: kept or held, VAL: held, **{part: of for part, of in parts.items() if part != TRAIN}}, notes


def _count(unknown: Sequence[Sequence[Entry]], ends: set[str]) -> int:
    """Number of folders, and of videos in each, whose images the ends, by their names, are."""
    return len(
        {
            (k, instant[0])
            for k, run in enumerate(unknown)
            for entry, (_, instant) in zip(run, taken_of(run), strict=True)
            if entry.name in ends
        }
    )


def _end_of(clip: Sequence[Entry]) -> list[Entry]:
    """Select the last images of the only clip, and leave some."""
    instants = [instant for _, instant in taken_of(clip)]
    last = [entry for entry, instant in zip(clip, instants, strict=True) if instant == instants[-1]]
    held = ends_of(clip, VAL_SHARE) or last
    return held if len(held) < len(clip) else list(clip[-1:])


def oyster_masks(example: Example) -> Iterator[NDArray[np.bool_]]:
    """Masks (H, W) of the oysters, in the order of their numbers."""
    instances = np.where(example.image.classes == OYSTER, example.image.instances, 0)
    return (instances == number for number in np.unique(instances[instances > 0]))


def joined_polygon(polygons: list[Array]) -> Array:
    """Join several polygons into one (N, 2), each by a slit between its nearest corner and those before: filled by the
    even-odd rule, it covers the same area."""
    whole = polygons[0]
    for piece in polygons[1:]:
        between = np.linalg.norm(whole[:, None] - piece[None], axis=2)
        at, start = np.unravel_index(int(between.argmin()), between.shape)
        around = np.concatenate([piece[start:], piece[: start + 1]])
        whole = np.concatenate([whole[: at + 1], around, whole[at:]])
    return whole


def _polygon(mask: NDArray[np.bool_]) -> str:
    left, right, top, bottom = _edges(mask)
    pieces = [np.array(polygon).reshape(-1, 2) for polygon in mask_polygons(mask[top:bottom, left:right])]
    whole = joined_polygon(sorted(pieces, key=lambda piece: -len(piece)))
    height, width = mask.shape
    return _line(((whole + np.array([left, top])) / [width, height]).ravel().tolist())


def _box(mask: NDArray[np.bool_]) -> str:
    left, right, top, bottom = _edges(mask)
    height, width = mask.shape
    return _line(
        [(left + right) / 2 / width, (top + bottom) / 2 / height, (right - left) / width, (bottom - top) / height]
    )


def _edges(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Left, right, top and bottom of the bounding box of a mask, px."""
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    return int(columns[0]), int(columns[-1]) + 1, int(rows[0]), int(rows[-1]) + 1


def _line(values: list[float]) -> str:
    return " ".join(["0", *(f"{value:.{DIGITS}g}" for value in values)])


def _data(name: str, task: str, parts: Parts) -> str:
    """Content of data.yaml, with paths relative to its folder; YOLO always requires a train and a val, of which no
    other side is trained on."""
    places = {TRAIN: TRAIN, VAL: VAL if VAL in parts else next(iter(parts)), **{part: part for part in parts}}
    lines = [f"{part}: images/{place}" for part, place in places.items()]
    return "\n".join([f"# oysterbench {name}, labels to {task}", *lines, "names:", "  0: oyster", ""])
