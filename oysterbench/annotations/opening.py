"""Detection of the kind of labelled data at a path, and its opening."""

from __future__ import annotations

from pathlib import Path

from oysterbench.annotations.image import LabelledSet
from oysterbench.core.errors import LabelError

KINDS = {
    "sequences": "a sequence file (.mcap), or a folder of them, with the layers class and instance",
    "yolo": "a folder with images/ and labels/*.txt",
    "masks": "a folder with images/ and masks/*.png",
    "coco": "a folder with one COCO file (*.json) and the images that it names, or the file itself",
}


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
        got = f"what could be {' or '.join(found)}" if found else "none of them"
        raise LabelError(f"{path}: expected {'; or '.join(KINDS.values())}; got {got}")
    if found[0] == "sequences":
        from oysterbench.annotations.sequences import sequence_set

        if path.is_file():
            return sequence_set(path.stem, [path])
        return sequence_set(path.resolve().name, sorted(path.glob("*.mcap")))
    if found[0] == "yolo":
        from oysterbench.annotations.yolo import yolo_set

        return yolo_set(path)
    if found[0] == "masks":
        from oysterbench.annotations.folders import mask_set

        return mask_set(path)
    from oysterbench.annotations.coco_set import coco_set

    return coco_set(path) if path.is_file() else coco_set(next(iter(sorted(path.glob("*.json")))), whole=True)


def kinds_at(path: Path) -> list[str]:
    """Kinds of labelled data (keys of `KINDS`) that a path could be."""
    if path.is_file():
        return {".mcap": ["sequences"], ".json": ["coco"]}.get(path.suffix.lower(), [])
    found = ["sequences"] if any(path.glob("*.mcap")) else []
    if (path / "images").is_dir():
        found += ["yolo"] if (path / "labels").is_dir() else []
        found += ["masks"] if (path / "masks").is_dir() else []
    if len(list(path.glob("*.json"))) == 1 and not found:
        found.append("coco")
    return found
