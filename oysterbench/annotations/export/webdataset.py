"""WebDataset: data/PART-00000.tar and on, each image as consecutive files KEY.image.jpg, KEY.class.png, and so on.

`webdataset` and `datasets` read them as streams; `datasets` wants the same fields in every sample, so that all images
are .jpg or all are .png. The tar files contain no time, owner or mode of this machine.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from oysterbench.annotations.export.card import write_card
from oysterbench.annotations.export.examples import Example, Parts, common_suffix, examples
from oysterbench.sequence.pictures import png_bytes

SHARD_BYTES = 300_000_000
"""Size at which a tar file is full: parallel readers hold a few at a time."""


def write(name: str, parts: Parts, folder: Path, step: Callable[[], None], shard_bytes: int = SHARD_BYTES) -> list[str]:
    """Write shards and card."""
    data = folder / "data"
    data.mkdir()
    notes, objects = [], {}
    suffix = common_suffix(entry for entries in parts.values() for entry in entries)
    for part, entries in parts.items():
        objects[part] = 0
        with _shards(data, part, shard_bytes) as add:
            for example in examples(entries, suffix):
                files = files_of(example)
                objects[part] += len(json.loads(files["json"])["objects"])
                add(example.key, files)
                step()
        count = len(list(data.glob(f"{part}-*.tar")))
        notes.append(f"{part}: {len(entries)} images in {count} shard{'s' if count > 1 else ''}")
    write_card(folder, name, parts, objects, "webdataset")
    return notes


def files_of(example: Example) -> dict[str, bytes]:
    """Files of a sample: extension -> bytes."""
    height, width = example.image.classes.shape
    facts = {
        "id": example.image.name,
        "clip": example.image.clip,
        "width": width,
        "height": height,
        "conditions": json.loads(example.conditions()),
        "objects": example.objects(),
    }
    planes = {f"{name}.png": png_bytes(plane) for name, plane in example.planes().items()}
    return {f"image.{example.suffix}": example.data, **planes, "json": json.dumps(facts, sort_keys=True).encode()}


@contextmanager
def _shards(folder: Path, part: str, shard_bytes: int) -> Iterator[Callable[[str, dict[str, bytes]], None]]:
    """Provide a function that adds samples to the tar files of a part, starting a new one when one is full."""
    number, written, tar = -1, shard_bytes, None

    def add(key: str, files: dict[str, bytes]) -> None:
        nonlocal number, written, tar
        if written >= shard_bytes or tar is None:
            if tar is not None:
                tar.close()
            number, written = number + 1, 0
            # The headers are ustar's, but for names over 100 characters, for which ustar has no place.
            tar = tarfile.open(folder / f"{part}-{number:05d}.tar", "w", format=tarfile.PAX_FORMAT)  # noqa: SIM115
        for extension, data in files.items():
            entry = tarfile.TarInfo(f"{key}.{extension}")
            entry.size = len(data)
            tar.addfile(entry, io.BytesIO(data))
            written += len(data)

    try:
        yield add
    finally:
        if tar is not None:
            tar.close()
