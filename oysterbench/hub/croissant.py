"""A split's version as Croissant JSON-LD, which data set search engines and loaders read (MLCommons, version 1.0)."""

from __future__ import annotations

import json
import re
from importlib import resources

from oysterbench.hub.canonical import canonical
from oysterbench.hub.manifest import LICENCE, Manifest

CONTEXT = "croissant.json"
"""File next to this one: the JSON-LD context that the specification gives."""

SEQUENCES = "sequences"

FIELDS = {
    "name": ("sc:Text", "Name of the sequence."),
    "file": ("sc:Text", "The file that holds it."),
    "duration_s": ("sc:Float", "Seconds from the first message to the last."),
    "size": ("sc:Integer", "Bytes of the file."),
}
"""Fields of a row in the table of sequences -> type and description."""


def croissant(manifest: Manifest, published: str, url: str = "") -> bytes:
    """Describe a manifest as a Croissant document. Addresses of files are relative to the folder `croissant` of the
    tree, or start with `url`, the tree's own address, where one is given; published: date, UTC."""
    base = f"{url.rstrip('/')}/blobs/" if url else "../blobs/"
    files = [
        {
            "@type": "cr:FileObject",
            "@id": entry.name,
            "name": entry.name,
            "description": f"Sequence {entry.sequence}: ROS 2 messages on {len(entry.content)} topics.",
            "contentSize": f"{entry.size} B",
            "contentUrl": f"{base}{entry.sha256}",
            "encodingFormat": "application/octet-stream",  # MCAP has no registered media type
            "sha256": entry.sha256,
        }
        for entry in manifest.files
    ]
    rows = [
        {
            f"{SEQUENCES}/name": entry.sequence,
            f"{SEQUENCES}/file": entry.name,
            f"{SEQUENCES}/duration_s": entry.duration_ns * 1e-9,
            f"{SEQUENCES}/size": entry.size,
        }
        for entry in manifest.files
    ]
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"{SEQUENCES}/{name}",
            "name": name,
            "description": text,
            "dataType": kind,
        }
        for name, (kind, text) in FIELDS.items()
    ]
    return canonical(
        {
            "@context": json.loads((resources.files("oysterbench.hub") / CONTEXT).read_bytes()),
            "@type": "sc:Dataset",
            "conformsTo": "http://mlcommons.org/croissant/1.0",
            "name": re.sub("[^A-Za-z0-9_-]", "-", manifest.split),
            "description": description(manifest),
            "version": semantic(manifest.version),
            "license": LICENCE,
            **({"url": url} if url else {}),
            "datePublished": published,
            "creator": {"@type": "sc:Organization", "name": "oysterbench"},
            "keywords": ["underwater robotics", manifest.track, "oyster reef", "simulation", "benchmark"],
            "citeAs": f"oysterbench split {manifest.split} {manifest.version}, manifest SHA-256 {manifest.sha256}",
            "isLiveDataset": False,
            "distribution": files,
            "recordSet": [
                {
                    "@type": "cr:RecordSet",
                    "@id": SEQUENCES,
                    "name": SEQUENCES,
                    "description": "One row per sequence.",
                    "field": fields,
                    "data": rows,
                }
            ],
        }
    )


def description(manifest: Manifest) -> str:
    """Describe the split in one paragraph."""
    topics = sorted({topic for entry in manifest.files for topic in entry.content})
    truth = "The truth is kept back for the evaluation server." if manifest.hidden else "The truth is in the files."
    return (
        f"{manifest.summary}. Rendered by oysterbench {manifest.oysterbench} for the track {manifest.track}, vehicle "
        f"{manifest.rig}; {len(manifest.files)} sequences as MCAP files in the ROS 2 profile, topics "
        f"{', '.join(topics)}. {truth}"
    )


def semantic(version: str) -> str:
    """Convert a version such as 1.0 to MAJOR.MINOR.PATCH, as Croissant requires."""
    numbers = re.findall(r"\d+", version)[:3]
    return ".".join(numbers + ["0"] * (3 - len(numbers)))
