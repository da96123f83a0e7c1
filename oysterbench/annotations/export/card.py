"""Data-set card for Hugging Face: README.md, whose front matter tells `datasets` where to find what."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from oysterbench.annotations.export.examples import Parts, rendered
from oysterbench.annotations.manifest import TEST, TRAIN, VAL
from oysterbench.recipe import CLASSES
from oysterbench.version import VERSION

SPLITS = {TRAIN: "train", VAL: "validation", TEST: "test"}
"""Part -> its name on Hugging Face."""

SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
LARGEST = "1M<n<10M"

USE = {
    "parquet": """from datasets import load_dataset

data = load_dataset("parquet", data_files={{"{split}": "data/{part}-*.parquet"}}, split="{split}")
row = data[0]
row["image"], row["class"], row["instance"]  # PIL images
row["objects"]  # id, category, bbox, area, state of each""",
    "webdataset": """import io, json
import webdataset
from PIL import Image

for sample in webdataset.WebDataset("data/{part}-00000.tar", shardshuffle=False):
    picture = Image.open(io.BytesIO(sample.get("image.jpg") or sample["image.png"]))
    instances = Image.open(io.BytesIO(sample["instance.png"]))  # 16 bits, as decoders to RGB do not keep
    facts = json.loads(sample["json"])""",
}
"""Format -> code that reads it."""


def write_card(folder: Path, name: str, parts: Parts, objects: Mapping[str, int], form: str) -> None:
    """Write README.md. objects: number of labelled objects by part."""
    suffix = {"parquet": "parquet", "webdataset": "tar"}[form]
    total = sum(map(len, parts.values()))
    size = next((label for limit, label in SIZES if total < limit), LARGEST)
    ours = rendered(parts)
    head = [
        "---",
        *(["license: cc-by-4.0"] if ours else []),
        f"pretty_name: {json.dumps(name)}",
        "task_categories:",
        "- image-segmentation",
        "- object-detection",
        "tags:",
        *(f"- {tag}" for tag in ("underwater", "oysters", *(["synthetic"] if ours else []), form)),
        "size_categories:",
        f"- {size}",
        "configs:",
        "- config_name: default",
        "  data_files:",
        *(
            line
            for part in parts
            for line in (f"  - split: {SPLITS.get(part, part)}", f"    path: data/{part}-*.{suffix}")
        ),
        "---",
    ]
    part = next(iter(parts))
    use = USE[form].format(part=part, split=SPLITS.get(part, part))
    rows = [
        f"| {SPLITS.get(part, part)} | {len(entries)} | {len({entry.clip for entry in entries})} | {objects[part]} |"
        for part, entries in parts.items()
    ]
    alone = all(len({entry.clip for entry in entries}) == len(entries) for entries in parts.values())
    made = (
        "Rendered images of oyster reefs with exact labels"
        if ours
        else "Labelled images of oysters; their licence is their owner's"
    )
    body = [
        f"# {name}",
        "",
        f"{made}, exported by oysterbench {VERSION}.",
        "",
        "| part | images | clips | labelled objects |",
        "| --- | ---: | ---: | ---: |",
        *rows,
        "",
        "Images of a clip resemble each other: divide by clips, never by images."
        + " Here no clips were known, so each image is one: neighbours may resemble each other, too." * alone,
        "",
        "| field | what |",
        "| --- | --- |",
        "| `id`, `clip` | name of the image, and of what it was taken in one go with |",
        "| `image` | the image, as it was stored |",
        "| `class` | 8 bits, a class for each pixel, see below |",
        "| `instance` | 16 bits, a number for each object, 0 for none |",
        "| `ignore` | 255 where nothing may be said: oysters too small or too hidden to be counted |",
        "| `objects` | `id` in `instance`, `category`, `bbox` [x, y, width, height] px, `area` px, `state` |",
        "| `conditions` | JSON: camera, water, light and density, as far as they are known |",
        "",
        "Classes: " + ", ".join(f"{number} {label}" for number, label in CLASSES.items()) + ".",
        "",
        "```python",
        use,
        "```",
    ]
    (folder / "README.md").write_text("\n".join([*head, "", *body, ""]), encoding="utf-8")
