"""Hugging Face: README.md, the data-set card, and data/PART-00000.parquet and on, which `datasets` opens with types.

Images and planes are image files in the columns; the metadata of the schema tells `datasets` how to read them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from oysterbench.annotations.export.card import write_card
from oysterbench.annotations.export.examples import Example, Parts, examples
from oysterbench.annotations.image import Entry
from oysterbench.core.errors import MissingExtraError
from oysterbench.recipe import CLASSES
from oysterbench.sequence.pictures import png_bytes

SHARD_BYTES = 300_000_000
"""Size at which a shard is full, before compression."""
ROWS = 32
"""Rows of a row group, the least that a reader loads at once."""
STATES = ("unknown", "live", "dead")

PICTURES = ("image", "class", "instance", "ignore")


def write(name: str, parts: Parts, folder: Path, step: Callable[[], None], shard_bytes: int = SHARD_BYTES) -> list[str]:
    """Write shards and card. Raises MissingExtraError without pyarrow."""
    try:
        import pyarrow as arrow
        from pyarrow import parquet
    except ImportError:
        raise MissingExtraError(
            "the format parquet needs pyarrow, which is not installed; type: pip install 'oysterbench[parquet]', or "
            "choose the format webdataset, which needs no extra",
            name="pyarrow",
        ) from None
    schema = _schema(arrow)
    data = folder / "data"
    data.mkdir()
    notes, objects = [], {}
    for part, entries in parts.items():
        objects[part], number, written, writer = 0, -1, shard_bytes, None
        try:
            for rows in _rows(entries, step):
                if writer is None or written >= shard_bytes:
                    if writer is not None:
                        writer.close()
                    number, written = number + 1, 0
                    place = data / f"{part}-{number:05d}.parquet"
                    writer = parquet.ParquetWriter(place, schema, compression="zstd", write_page_index=True)
                writer.write_batch(arrow.RecordBatch.from_pylist(rows, schema=schema))
                written += sum(len(row[column]["bytes"]) for row in rows for column in PICTURES)
                objects[part] += sum(len(row["objects"]) for row in rows)
        finally:
            if writer is not None:
                writer.close()
        notes.append(f"{part}: {len(entries)} images in {number + 1} shard{'s' if number else ''}")
    write_card(folder, name, parts, objects, "parquet")
    return notes


def _rows(entries: Sequence[Entry], step: Callable[[], None]) -> Iterator[list[dict[str, Any]]]:
    """Yield the rows of one row group at a time."""
    made = examples(entries)
    while batch := list(islice(made, ROWS)):
        rows = []
        for example in batch:
            rows.append(row_of(example))
            step()
        yield rows


def row_of(example: Example) -> dict[str, Any]:
    """Make the row of an image, as Python values."""
    image = example.image
    height, width = image.classes.shape
    numbers = {name: number for number, name in CLASSES.items()}
    objects = [
        {**found, "category": numbers[found["category"]], "state": STATES.index(found["state"])}
        for found in example.objects()
    ]
    planes = {
        plane: {"bytes": png_bytes(values), "path": f"{example.key}.{plane}.png"}
        for plane, values in example.planes().items()
    }
    return {
        "id": image.name,
        "clip": image.clip,
        "width": width,
        "height": height,
        "conditions": example.conditions(),
        "image": {"bytes": example.data, "path": f"{example.key}.image.{example.suffix}"},
        **planes,
        "objects": objects,
    }


def _schema(arrow: Any) -> Any:
    """Schema of the columns, with the features of `datasets` in its metadata."""
    picture = arrow.struct([("bytes", arrow.binary()), ("path", arrow.string())])
    found = arrow.struct(
        [
            ("id", arrow.int32()),
            ("category", arrow.int64()),
            ("bbox", arrow.list_(arrow.int32())),
            ("area", arrow.int32()),
            ("state", arrow.int64()),
        ]
    )
    texts = [(name, arrow.string()) for name in ("id", "clip")]
    sizes = [(name, arrow.int32()) for name in ("width", "height")]
    pictures = [(name, picture) for name in PICTURES]
    columns = [*texts, *sizes, ("conditions", arrow.string()), *pictures, ("objects", arrow.list_(found))]
    features = json.dumps({"info": {"features": _features()}})
    return arrow.schema(columns, metadata={"huggingface": features})


def _features() -> dict[str, Any]:
    """Features in the form of `datasets.Features.to_dict`."""
    text, whole = {"dtype": "string", "_type": "Value"}, {"dtype": "int32", "_type": "Value"}
    found = {
        "id": whole,
        "category": {"names": list(CLASSES.values()), "_type": "ClassLabel"},
        "bbox": [whole],
        "area": whole,
        "state": {"names": list(STATES), "_type": "ClassLabel"},
    }
    head = {"id": text, "clip": text, "width": whole, "height": whole, "conditions": text}
    return {**head, **{name: {"_type": "Image"} for name in PICTURES}, "objects": [found]}
