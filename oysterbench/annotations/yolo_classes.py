"""Classes and sides of YOLO data sets, as data.yaml and files like it name them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from oysterbench.annotations.categories import Categories, categories_of
from oysterbench.annotations.manifest import SIDE_LAST, SIDES, side_in
from oysterbench.core.errors import LabelError
from oysterbench.core.places import shown

FILES = ("data.yaml", "data.yml", "classes.txt")
"""Files that may name the classes; the first that does is read. classes.txt has a name per line."""
LISTS = (".txt", ".names")
"""Suffixes of files with a name per line; .names is that of darknet."""
NAMES = re.compile(rb"^(?:\xef\xbb\xbf)?[\"']?names[\"']?\s*:", re.MULTILINE)
"""What is in a YAML file that names classes, also behind the byte order mark of Windows."""
ANY = ("data", "dataset", "datasets", "images", "labels")
"""Names of folders in the paths of any set."""
USUAL = {0: "oyster"}
"""Names of the classes where no file gives them."""


def classes_of(folder: Path) -> tuple[dict[int, str], tuple[Path, ...]]:
    """Names of the classes of a data set by number, and the file that gives them, if they are others than without one.

    Read are `FILES` in the folder, or else in the one above if this is called train, valid or test (`SIDES`), which
    share them; a YAML file there also if it names this folder, or the name of this ends in such a word and the file
    names no folders of other sets alone. Raises LabelError where others are named elsewhere: here in a YAML file of
    another name, or in a list as darknet has it (`LISTS`), or above by a file that may be of this data set or not: one
    called data.yaml, that has oysters among its classes, or that lists this folder.
    """
    whole = folder.resolve()
    own = [folder / name for name in FILES]
    above = [path for path in (whole.parent / name for name in FILES) if path.is_file() and _is_of(path, whole)]
    for path in (path for path in (*own, *above) if path.is_file()):
        if names := read_classes(path):
            return names, () if names == USUAL else (path,)
    for path in _that_may_name(folder):
        if path.is_file() and _names_others(path):
            raise LabelError(_elsewhere(path))
    for path in (*_that_may_name(whole.parent), whole.parent / FILES[-1]):
        if path.is_file() and _names_others(path, whole):
            if whole.name.casefold() in SIDES:
                raise LabelError(_elsewhere(path))
            raise LabelError(
                f"{path}: expected the names of the classes of {whole.name}/ in {_usual(path)} there, got names here "
                "that may be of it or not: copy them there, or write others there, such as `oyster` in classes.txt"
            )
    return USUAL, ()


def _that_may_name(folder: Path) -> list[Path]:
    """Files of other names that may name classes."""
    return [*shown(folder, "*.y*ml"), *shown(folder, f"*{LISTS[-1]}")]


def _elsewhere(path: Path) -> str:
    """What to say where a file of another name names the classes."""
    return f"{path}: expected the names of the classes in {_usual(path)}, got them here: rename it"


def _usual(path: Path) -> str:
    """Name of the file that should name the classes as this one does."""
    return FILES[-1] if path.suffix in LISTS else FILES[0]


def _is_of(path: Path, folder: Path) -> bool:
    """Whether a file that names classes is of a folder beside it."""
    if folder.name.casefold() in SIDES or path.suffix == ".txt":
        return folder.name.casefold() in SIDES
    try:
        return bool(keys_naming(path, folder.name) or (side_in(folder.name) and _may_be_of(path, folder)))
    except LabelError:
        return bool(side_in(folder.name))  # to be refused where it is read, with the reason


def _may_be_of(path: Path, folder: Path) -> bool:
    """Whether a YAML file may list the set of which a folder beside it is a side: if it lists another side of it, as
    reef-train of reef-test, or paths that are of any set, as train/images, or that end at the folder of the file."""
    wholes = [[SIDE_LAST.sub("", part).casefold() for part in place.parts] for place in _listed(path)] or [[]]
    named = {next((part for part in parts[::-1] if part not in ("", "images", "..", "/")), "") for parts in wholes}
    whole = SIDE_LAST.sub("", folder.name).casefold()
    return any(whole in parts for parts in wholes if whole) or named <= {"", folder.parent.name.casefold()}


def _lists(path: Path, folder: Path) -> bool:
    """Whether a YAML file lists paths with the name of a folder in them, with or without a side at its end; of a folder
    that is a side, whether it lists sides beside it, or of the name of the folder above. Names that any set may have
    (`ANY`) say nothing."""
    name = folder.name.casefold()
    listed = [[part.casefold() for part in place.parts if part not in ("images", "..", "/")] for place in _listed(path)]
    if name in SIDES:
        wholes = [parts[:-1] for parts in listed if parts and side_in(parts[-1])]
        return any(parts[-1:] in ([], [folder.parent.name.casefold()]) for parts in wholes)
    own = {name, SIDE_LAST.sub("", name).rstrip("-_. ")} - {"", *ANY}
    return any(part in own for parts in listed for part in parts)


def _listed(path: Path) -> list[PurePosixPath]:
    """Paths of images, or of files that list such, that a YAML file lists, or the one below which they are."""
    content = _mapping(path) or {}
    base = next(_places(content.get("path")), PurePosixPath())
    places = [base / place for key in SIDES for place in _places(content.get(key))]
    return [place.parent if place.suffix == ".txt" else place for place in places] or [base]


def _places(value: Any) -> Iterator[PurePosixPath]:
    """Paths that are the value of a key of a YAML file, one or a list."""
    for place in value if isinstance(value, list) else [value]:
        if isinstance(place, str):
            yield PurePosixPath(place.replace("\\", "/"))


def _names_others(path: Path, beside: Path | None = None) -> bool:
    """Whether a file names other classes than there are without one. beside: a folder that it may be of or not; where
    it names no oysters, or cannot be read, it is of something else unless it is called data.yaml or lists this folder.
    Raises LabelError where a file that is of no other folder names none."""
    try:
        if path.suffix not in LISTS and not NAMES.search(path.read_bytes()):
            return False
        return read_classes(path) not in ({}, USUAL)
    except (LabelError, OSError):
        if beside is None:
            raise
    try:
        return path.name in FILES[:2] or _lists(path, beside)
    except LabelError:
        return False


def side_of(folder: Path, part: str) -> str:
    """Side of the images in images/PART of a data set: which the name ends in (`side_in`), or under which alone, or by
    its own name, data.yaml lists it. Raises LabelError if neither says it."""
    files = [folder / name for name in FILES[:2] if (folder / name).is_file()]
    keys = {key for path in files for key in keys_naming(path, part)} - {"path"}
    said = side_in(part) or (part if part in keys else keys.pop() if len(keys) == 1 else "").casefold()
    if not said:
        raise LabelError(
            f"{folder / 'images' / part}: expected folders called train, val or test, or named under one of these in "
            f"{FILES[0]}: rename or name it, or move its images to images/ and their labels to labels/"
        )
    return SIDES.get(said, said)


def keys_naming(path: Path, folder: str) -> set[str]:
    """Keys under which a YAML file names a folder, or images/ in it, at the end of a path, wherever this leads from
    here: Roboflow writes ../train/images, others where a set was at their place."""
    found = set()
    for key, value in (_mapping(path) or {}).items():
        if key == "names":
            continue
        for parts in (place.parts for place in _places(value)):
            if parts[-1:] == (folder,) or parts[-2:] == (folder, "images"):
                found.add(str(key))
    return found


def read_classes(path: Path) -> dict[int, str]:
    """Read the names of the classes from a file of `FILES`, by number, all that are of oysters as oyster
    (`categories_of`); empty if it names none. Raises LabelError if it cannot be read, or no name says oyster."""
    names = listed_names(path) if path.suffix in LISTS else _names(path)
    if not names:
        return {}
    oysters = _categories(names).states
    found = {number: "oyster" if number in oysters else name for number, name in names.items()}
    if not any("oyster" in name.casefold() for number, name in names.items() if number in oysters):
        known = ", ".join(f"{number} = {name}" for number, name in names.items())
        raise LabelError(f"{path}: no class is named 'oyster'; its classes: {known or 'none'}: rename the one meant")
    return found


def that_may_be_oysters(names: Mapping[int, str]) -> set[int]:
    """Numbers of the classes that are of oysters, or may be, by their names."""
    found = _categories(names)
    return {*found.states, *found.doubtful}


def _categories(names: Mapping[int, str]) -> Categories:
    return categories_of([{"id": number, "name": name} for number, name in names.items()])


def listed_names(path: Path) -> dict[int, str]:
    """Read a list of names, one per line, by number. Raises LabelError if it cannot be read."""
    try:
        lines = path.read_text(encoding="utf-8-sig").rstrip().splitlines()
    except OSError as error:
        raise LabelError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise LabelError(f"{path}: expected text in UTF-8, got {error}: save it as UTF-8") from None
    return dict(enumerate(line.strip() for line in lines))


def _names(path: Path) -> dict[int, str] | None:
    content = _mapping(path)
    names = None if content is None else content.get("names")
    if names is None:
        return None
    found = dict(enumerate(names)) if isinstance(names, list) else names
    if not isinstance(found, Mapping) or not all(type(number) is int for number in found):
        raise LabelError(f"{path}: names: expected a list, or number: name, got {str(names)[:60]!r}")
    return {number: str(name) for number, name in found.items()}


def _mapping(path: Path) -> Mapping[Any, Any] | None:
    """Content of a YAML file; None if it is no mapping. Raises LabelError if it cannot be read."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        content = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, YAMLError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "not YAML"
        raise LabelError(f"{path}: {why}; expected the names of the classes under 'names'") from None
    return content if isinstance(content, Mapping) else None
