"""Runs of images: which images follow each other in time, as far as clips and names say, and their ends to hold out."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from oysterbench.annotations.image import Entry

TIME = re.compile(r"(?<![^-_/])(?:\d+[-_T])*\d\d[-_][0-5]\d$")
"""End of a name that is a time in parts, with or without a date: 2026-05-01_12-30-05, or 03-59 of a video."""
CAMERAS, FEW = 4, 30
"""Of more than this many prefixes with fewer than this many images each, none is taken for a camera: they are quadrats
or sites, and their numbers are no times."""


@dataclass(frozen=True)
class Run:
    """Images that follow each other, in order of time. known: whether a clip says so; otherwise they are the images of
    one folder, in the order of their names."""

    entries: tuple[Entry, ...]
    known: bool


def runs_of(entries: Iterable[Entry]) -> list[Run]:
    """Group images into runs, in the order of their first images: those of a clip; and of images whose clips are not
    known (each is a clip of its own name) those of a folder of their names."""
    groups: dict[tuple[str, bool], list[Entry]] = {}
    for entry in entries:
        known = entry.clip != entry.name
        groups.setdefault((entry.clip if known else entry.name.rpartition("/")[0], known), []).append(entry)
    return [
        Run(tuple(group if known else sorted(group, key=lambda entry: entry.name)), known)
        for (_, known), group in groups.items()
    ]


def ends_of(entries: Sequence[Entry], share: float) -> list[Entry]:
    """Select the last share (rounded down) of what each camera took, of the images of one run in order of time; an
    image of another camera at the same instant, which shows the same ground, is selected too. Where that is less than
    half of this share of all images, as most cameras took too few, the last share of all instants, or of all images, is
    selected."""
    taken = taken_of(entries)
    cameras: dict[str, list[str]] = {}
    for camera, instant in taken:
        cameras.setdefault(camera, []).append(instant)
    instants = {instant for of in cameras.values() for instant in of[len(of) - int(share * len(of)) :]}
    found = [entry for entry, (_, instant) in zip(entries, taken, strict=True) if instant in instants]
    return found if found and len(found) >= share * len(entries) / 2 else _last_of(entries, taken, share)


def taken_of(entries: Sequence[Entry]) -> list[tuple[str, str]]:
    """What took each image of a run, and when, as far as names say: frames of sequences are named
    SEQUENCE/CAMERA/STAMP, or with dashes or underscores in folders. Cameras that looked at the same time have the same
    instant. Where names do not say so, the camera is empty, and the instant is the name."""
    timed = all(TIME.search(entry.name) for entry in entries)
    taken = [_taken(entry.name, timed) for entry in entries]
    counts = Counter(camera for camera, _ in taken)
    if len(counts) > CAMERAS and len(entries) < FEW * len(counts):
        return [("", entry.name) for entry in entries]
    return taken


def _taken(name: str, timed: bool) -> tuple[str, str]:
    """Camera and instant of a name. timed: whether it ends with a time in parts."""
    found = TIME.search(name) if timed else None
    camera, _, instant = name.replace("/", "-").replace("_", "-").rpartition("-")
    if found is not None:
        camera, instant = name[: found.start()], found.group()
    return (camera, instant) if timed or instant.isdecimal() else ("", name)


def _last_of(entries: Sequence[Entry], taken: Sequence[tuple[str, str]], share: float) -> list[Entry]:
    """Select the images of the last share of all instants, at least of one; where these are more than twice the share
    of all images, as of many cameras at few instants, or less than half of it, as of cameras that took more images than
    others, select the last share of the images as they stand."""
    instants = sorted({instant for _, instant in taken}, key=lambda instant: (len(instant), instant))
    last, most = instants[-max(1, int(share * len(instants))) :], int(share * len(entries))
    found = [entry for entry, (_, instant) in zip(entries, taken, strict=True) if instant in last]
    return found if most / 2 <= len(found) <= 2 * most else list(entries[len(entries) - most :])
