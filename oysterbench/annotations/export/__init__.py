"""Export of labelled sets for training networks, with one module per format: `export_set` writes them as a folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path

from oysterbench.annotations.export.examples import Parts, parted
from oysterbench.annotations.image import LabelledSet
from oysterbench.core.atomic import appearing_folder
from oysterbench.core.disk_space import SpaceCheck
from oysterbench.core.errors import LabelError

SET_FORMATS = {
    "yolo": "YOLO: segment/ and detect/, each with data.yaml, images/ and labels/ for train and val; oysters",
    "webdataset": "WebDataset: tar shards of images, classes, instances and JSON, with a card for Hugging Face",
    "parquet": "Hugging Face: a data-set card (README.md) and Parquet shards (needs oysterbench[parquet])",
}
"""Formats of labelled images -> their descriptions; each is a module of that name with a function `write` (`Write`)."""

Progress = Callable[[int, int], None]
"""Called with the number of images done, and their total."""

Write = Callable[[str, Parts, Path, Callable[[], None]], list[str]]
"""Writes the parts of a set of a given name to a folder, calls a function after each image, and returns notes."""


def export_set(
    sets: Sequence[LabelledSet],
    form: str,
    out: str | os.PathLike[str],
    progress: Progress = lambda done, total: None,
) -> tuple[Path, list[str]]:
    """Write labelled sets in a format (`SET_FORMATS`) as the folder `out`, atomically.

    The part of an image (train, val, test) is as its set states; else by the set's name if that ends in such a word
    (`manifest.side_in`); else train. The same sets give the same bytes. Returns the folder and notes about it. Raises
    LabelError if `out` already has content, or sets overlap, MissingExtraError if a format needs a package that is not
    installed, and MachineError if the export will not fit on the disk.
    """
    if form not in SET_FORMATS:
        raise LabelError(f"unknown format {form!r}; formats: {', '.join(SET_FORMATS)}")
    folder = Path(out)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise LabelError(f"{folder} already exists and was left unchanged: delete it or choose another --out")
    write: Write = import_module(f"{__name__}.{form}").write
    parts = parted(sets)
    total, done = sum(map(len, parts.values())), 0
    progress(done, total)

    with appearing_folder(folder) as draft:
        space = SpaceCheck(draft, folder)

        def step() -> None:
            nonlocal done
            done += 1
            progress(done, total)
            space.check(done, total)

        notes = write("+".join(one.name for one in sets), parts, draft, step)
    return folder, notes
