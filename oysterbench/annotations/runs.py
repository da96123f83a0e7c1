"""Runs of images: which images follow each other in time, as far as clips and names say, and their ends to hold out."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from oysterbench.annotations.image import Entry
from oysterbench.core.names import natural_key

_NO_CAMERA = r"(?<!cam[-_ ])(?<!camera[-_ ])"
TIME = re.compile(rf"(?<![^-_/ ]){_NO_CAMERA}(?:\d+[-_T ])*\d\d[-_][0-5]\d$", re.IGNORECASE)
"""End of a name that is a time in parts, with or without a date: 2026-05-01_12-30-05, 2026-05-01 12-30-05, or 03-59 of
a video; not cam_01-05."""
ROBOFLOW = re.compile(r"_(?:jpe?g|png|bmp|webp|tiff?)\.rf\.\w+$", re.IGNORECASE)
"""What Roboflow adds to names; copies of an image by augmentation differ in it."""
LABEL_STUDIO = re.compile(r"(?<![^/])(?P<drawn>[0-9a-f]{8})-(?=[^/]+$)")
"""What Label Studio puts before names: eight random hex digits."""
_WORDS = r"(?:left|right|l|r|port|starboard|stbd)"
_SIDE = rf"(?:cam(?:era)?\d{{0,2}}|{_WORDS})"
GLUED = re.compile(rf"(?<![^-_/]){_WORDS}(?=\d+$)|\d(?={_WORDS}$)", re.IGNORECASE)
"""Ends of what is written in one with a number: left0001, 0001R."""
SIDE = re.compile(rf"(?<![^-_/]){_SIDE}(?![^-_/])", re.IGNORECASE)
"""Words for one of the cameras of a rig, such as a stereo camera: names that differ in them alone are of one instant,
also where a camera stopped earlier, or took few images, unless they looked at other times (`_by_time`)."""
SIDE_LAST = re.compile(rf"(\d+)[-_/]{_SIDE}$", re.IGNORECASE)
NUMBER = re.compile(r"\d+$")
"""Number at the end of a name: 000123, frame0001, left.7."""
_DIGIT, _MARK = r"(?<!\d)(?<![a-z]{2})" + _NO_CAMERA + r"\d", r"[^\w\s/()\[\]-]\s*"
LONGER = re.compile(
    rf"{_DIGIT}(?:{_MARK}(?!\d{{4,5}}$)|\d+{_MARK})\d+$|(?:\d\d[hm]|\d+min[-_ ]?)\d\d?$|\d\ds\d{{1,3}}$", re.IGNORECASE
)
"""End of a name whose last number is part of a longer one: behind digits and any mark but dashes, underscores, spaces,
slashes and brackets, as in 12:30:05, 3.96 or 1305031102.16, or behind a unit, as in 12h30m05 or 05s033; but not a
counter of four digits behind one, as in dive_1.0001, nor behind the number of a word, as in cam_0.12."""
CUT_OUT = re.compile(r"(?:crop|tile|patch|part|slice|aug)[-_]?$", re.IGNORECASE)
"""Ends of names before a number that counts pieces or copies of an image, and says no time."""
APART = 0.1
"""Cameras of one rig begin and end together, up to this share of their time; videos whose numbers restart do not."""
CAMERAS, FEW = 4, 30
"""Of more than this many prefixes with fewer than this many images each, none is taken for a camera: they are quadrats
or sites, and their numbers are no times."""

Instant = tuple[int, ...]
"""Instants of one rig are in order of time, and begin with its number."""


@dataclass(frozen=True)
class Run:
    """Images that follow each other, in order of time as far as their names say it (`taken_of`). known: whether a clip
    says so; otherwise they are the images of one folder, or of one for each camera of a rig (`SIDE`), in the order of
    their names without what programs add to them, 9 before 10."""

    entries: tuple[Entry, ...]
    known: bool


def runs_of(entries: Iterable[Entry]) -> list[Run]:
    """Group images into runs, in the order of their first images: those of a clip; and of images whose clips are not
    known (each is a clip of its own name, of which no other is) those of a folder of their names."""
    entries = list(entries)
    counts = Counter(entry.clip for entry in entries)
    unknown = [entry.name for entry in entries if entry.clip == entry.name and counts[entry.clip] == 1]
    folders = dict(zip(unknown, _folders(unknown), strict=True))
    groups: dict[tuple[str, bool], list[Entry]] = {}
    for entry in entries:
        known = entry.clip != entry.name or counts[entry.clip] > 1
        groups.setdefault((entry.clip if known else folders[entry.name], known), []).append(entry)
    return [Run(tuple(_in_time(group) if known else _by_name(group)), known) for (_, known), group in groups.items()]


def ends_of(entries: Sequence[Entry], share: float) -> list[Entry]:
    """Select the last share (rounded down) of the instants of each camera, of the images of one run; an image of
    another camera at the same instant, which shows the same ground, is selected too. Where that is less than half of
    this share of all images, as most cameras took too few, or more than twice as much, the last share of all instants,
    or of all images, is selected."""
    taken = taken_of(entries)
    cameras: dict[str, set[Instant]] = {}
    for camera, instant in taken:
        cameras.setdefault(camera, set()).add(instant)
    instants = {instant for of in cameras.values() for instant in sorted(of)[len(of) - int(share * len(of)) :]}
    found = [entry for entry, (_, instant) in zip(entries, taken, strict=True) if instant in instants]
    most = share * len(entries)
    return found if found and most / 2 <= len(found) <= 2 * most else _last_of(entries, taken, share)


def taken_of(entries: Sequence[Entry]) -> list[tuple[str, Instant]]:
    """What took each image of a run, and when, as far as names say: frames of sequences are named
    SEQUENCE/CAMERA/STAMP, or with dashes or underscores in folders. Cameras that names tell apart by such words as left
    and right (`SIDE`) are one where their times overlap; others of one rig (`_rigs`) that looked at the same time
    have the same instant; those of others, such as videos whose numbers restart, have other ones. Where names do not
    say so, or cameras are too many, the camera is empty, and the instant is the place in the run, of the first image of
    its camera and number, or of its name without the words of `SIDE`."""
    names = _bare([entry.name for entry in entries])
    said = _said(names)
    count = len({camera for camera, _ in said})
    rigs = _rigs(said) if count <= CAMERAS or len(said) >= FEW * count else {}
    first: dict[tuple[str, Instant], int] = {}
    taken: list[tuple[str, Instant]] = []
    for place, (camera, numbers) in enumerate(said):
        known = rigs and numbers
        key = (camera, numbers) if numbers else (SIDE.sub("", names[place]), ())
        at = first.setdefault(key, place) if numbers or _side_of(names[place]) else place
        taken.append((camera, (rigs[camera], *numbers)) if known else ("", (-1, at)))
    return taken


def _bare(names: Sequence[str]) -> list[str]:
    """The names of a run without what programs add to them, which is random: it would be what they are sorted by, or
    hide the number at their ends; and with a mark between this and a word of `SIDE`."""
    names = [GLUED.sub(r"\g<0>-", ROBOFLOW.sub("", name)) for name in names]
    drawn = [found["drawn"] for name in names if (found := LABEL_STUDIO.search(name))]
    # Dates have no letters, and numbers of videos are those of many images.
    random = len(drawn) == len(names) and 2 * len(set(drawn)) > len(set(names)) and not "".join(drawn).isdecimal()
    return [LABEL_STUDIO.sub("", name) for name in names] if random else names


def _said(names: Sequence[str]) -> list[tuple[str, Instant]]:
    """Camera and time of each image by its name: what stands before its time (`_times`), without words for one of the
    cameras of a rig where their times overlap, and this time; nothing for names without one."""
    sides, times = [_side_of(name) for name in names], _times(names)
    said = [(SIDE.sub("", name), time) for name, time in times]
    prefixes = {(side, name) for side, (name, _) in zip(sides, said, strict=True)}
    if all(sides) and len(prefixes) == len(set(sides)) and len(set(_rigs(said).values())) > 1:
        # Each camera has a prefix of its own, such as its serial number, which says no more than its word.
        said = [("-", time) for _, time in said]
    taken = [(name, side, time) for side, (name, time) in zip(sides, said, strict=True)]
    cameras = _by_time(one for one in taken if one[2])
    return [(cameras[name, side], time) if time else ("", ()) for name, side, time in taken]


def _times(names: Sequence[str]) -> list[tuple[str, Instant]]:
    """What stands before the time at the end of each name, with dashes for other marks, and this time: a number or,
    where all names have them, the numbers of a time in parts after their count; nothing where there is none."""
    names = [SIDE_LAST.sub(r"\1", name) for name in names]
    in_parts = all(TIME.search(name) for name in names)
    found: list[tuple[str, Instant]] = []
    for name in names:
        end = (TIME if in_parts else NUMBER).search(name)
        if end and (CUT_OUT.search(name[: end.start()]) or (not in_parts and LONGER.search(name))):
            end = None
        time = tuple(map(int, re.findall(r"\d+", end.group()))) if end else ()
        before = re.sub("[_/]", "-", name[: end.start()] if end else name)
        found.append((before, (len(time), *time) if in_parts else time))
    return found


def _folders(names: Sequence[str]) -> list[str]:
    """The folder of each image, without words for one of the cameras of a rig where their times overlap."""
    folders = [name.rpartition("/")[0] for name in names]
    taken = [(SIDE.sub("", folder), _side_of(folder)) for folder in folders]
    cameras = _by_time((*of, time) for of, (_, time) in zip(taken, _times(_bare(names)), strict=True))
    return [cameras[of] for of in taken]


def _side_of(name: str) -> str:
    """The words for one of the cameras of a rig in a name."""
    return "-".join(SIDE.findall(name))


def _by_time(taken: Iterable[tuple[str, str, Any]]) -> dict[tuple[str, str], str]:
    """What to call the cameras of each name without the words of `SIDE`, and these words: by the name and a number,
    which those share whose times overlap. Others number images each by itself, or looked at other ground: what one
    shows at its end is not shown by another at the same time. taken: name, words, and number or time of each image."""
    cameras: dict[str, dict[str, list[Any]]] = {}
    for name, side, time in taken:
        cameras.setdefault(name, {}).setdefault(side, []).append(time)
    found: dict[tuple[str, str], str] = {}
    for name, sides in cameras.items():
        group, last = 0, None
        for start, end, side in sorted((min(times), max(times), side) for side, times in sides.items()):
            group += last is not None and start > last
            last = end if last is None else max(last, end)
            found[name, side] = f"{name}\0{group}" if group else name
    return found


def _rigs(said: Sequence[tuple[str, Instant]]) -> dict[str, int]:
    """Number of the rig of each camera: those whose first and last images are at nearly the same places among all
    instants (`APART`) are on one."""
    order = {numbers: place for place, numbers in enumerate(sorted({numbers for _, numbers in said}))}
    places: dict[str, list[int]] = {}
    for camera, numbers in said:
        places.setdefault(camera, []).append(order[numbers])
    rigs: dict[str, int] = {}
    limits: list[tuple[int, int]] = []
    for camera, of in places.items():
        first, last = min(of), max(of)
        room = max(1, APART * (last - first))
        near = (k for k, (start, end) in enumerate(limits) if abs(start - first) <= room and abs(end - last) <= room)
        rigs[camera] = next(near, len(limits))
        if rigs[camera] == len(limits):
            limits.append((first, last))
    return rigs


def _in_time(clip: Sequence[Entry]) -> list[Entry]:
    """The images of a clip in order of time, where every name says it; where none does, as they stand, with those of an
    instant together; and as they stand where some do."""
    taken = taken_of(clip)
    return list(clip) if len({rig < 0 for _, (rig, *_) in taken}) > 1 else _ordered(taken, clip)


def _by_name(images: Sequence[Entry]) -> list[Entry]:
    """The images of a folder in the order of their names, those of the cameras of a rig one after the other."""
    names = _bare([entry.name for entry in images])
    keys = [(natural_key(SIDE.sub("", name)), natural_key(name)) for name in names]
    return [images[k] for k in sorted(range(len(images)), key=lambda k: keys[k])]


def _ordered(taken: Sequence[tuple[str, Instant]], entries: Sequence[Entry]) -> list[Entry]:
    """The images in order of their instants."""
    return [entry for _, entry in sorted(zip(taken, entries, strict=True), key=lambda pair: pair[0][1])]


def _last_of(entries: Sequence[Entry], taken: Sequence[tuple[str, Instant]], share: float) -> list[Entry]:
    """Select the images of the last share of all instants, at least of one; where these are more than twice the share
    of all images, as of many cameras at few instants, or less than half of it, as of cameras that took more images than
    others, select the last share of the images."""
    instants = sorted({instant for _, instant in taken})
    last, most = set(instants[-max(1, int(share * len(instants))) :]), int(share * len(entries))
    found = [entry for entry, (_, instant) in zip(entries, taken, strict=True) if instant in last]
    return found if most / 2 <= len(found) <= 2 * most else _ordered(taken, entries)[len(entries) - most :]
