"""Detection of the kind of labelled data at a path, and its opening."""

from __future__ import annotations

from pathlib import Path

from oysterbench.annotations.coco import program_of, read_json
from oysterbench.annotations.coco_set import coco_files, coco_set
from oysterbench.annotations.image import LabelledSet
from oysterbench.annotations.yolo import yolo_root, yolo_set
from oysterbench.core.errors import LabelError
from oysterbench.core.places import shown

KINDS = {
    "sequences": "a sequence file (.mcap), or a folder of them, with the layers class and instance",
    "yolo": "a folder with images/ and labels/*.txt, or images/train, labels/train and so on",
    "masks": "a folder with images/ and masks/*.png",
    "coco": "a folder with one COCO file (*.json, or in annotations/) and the images that it names, or the file itself",
}

NONE = "none of them"


def open_labelled(path: str | Path) -> LabelledSet:
    """Open the labelled images at a path, whose kind is detected from its content (`KINDS`). Raises LabelError if it is
    none of them, or could be several.

    Examples
    --------
    >>> len(open_labelled("mini-01.mcap"))
    4
    """
    path = Path(path)
    if not path.exists():
        raise LabelError(f"{path}: no such file or folder; expected {'; or '.join(KINDS.values())}")
    found = kinds_at(path)
    if len(found) != 1:
        raise LabelError(f"{path}: expected {'; or '.join(KINDS.values())}; got {got_at(path)}")
    if found[0] == "sequences":
        from oysterbench.annotations.sequences import sequence_set

        if path.is_file():
            return sequence_set(path.stem, [path])
        return sequence_set(path.resolve().name, shown(path, "*.mcap"))
    if found[0] == "yolo":
        return yolo_set(path)
    if found[0] == "masks":
        from oysterbench.annotations.folders import mask_set

        return mask_set(path)
    return coco_set(path) if path.is_file() else coco_set(coco_files(path)[0], whole=True)


def kinds_at(path: Path) -> list[str]:
    """Kinds of labelled data (keys of `KINDS`) that a path could be."""
    if path.is_file():
        return {".mcap": ["sequences"], ".json": ["coco"]}.get(path.suffix.lower(), [])
    found = ["sequences"] if shown(path, "*.mcap") else []
    found += ["yolo"] if yolo_root(path) else []
    found += ["masks"] if (path / "images").is_dir() and (path / "masks").is_dir() else []
    if not found and len(coco_files(path)) == 1:
        found.append("coco")
    return found


def got_at(path: Path) -> str:
    """What a path is that is not one of `KINDS`, and which to give instead, to end a message."""
    if found := kinds_at(path):
        return f"what could be {' or '.join(found)}"
    if len(files := coco_files(path)) > 1:
        smallest = min(files, key=lambda file: file.stat().st_size)
        if other := _program_of(smallest):
            converted = "export or convert them to one COCO file, or give that"
            return f"{len(files)} JSON files, as {smallest.name} of {other}: {converted}"
        return f"{len(files)} JSON files: give the COCO file that is meant, such as {files[0]}"
    below = [one for one in shown(path, "*") if one.is_dir() and len(kinds_at(one)) == 1]
    return f"{NONE} itself, but a folder of such: give one below, as {below[0]}" if below else NONE


def _program_of(path: Path) -> str:
    try:
        return program_of(read_json(path))
    except LabelError:
        return ""
