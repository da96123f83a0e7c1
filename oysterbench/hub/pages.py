"""The hub's page: what there is to download, with images and sizes. It is a file of the tree like the others."""

from __future__ import annotations

from pathlib import Path

import cv2
from markupsafe import Markup

from oysterbench.core.html import render
from oysterbench.hub.index import Index
from oysterbench.sequence import open_sequence

PICTURES = 3
WIDTH = 640  # px
QUALITY = 85

SCRIPT = """if (location.protocol.startsWith("http"))
  document.getElementById("address").textContent =
    (location.origin + location.pathname.replace(/[^/]*$/, "")).replaceAll("'", "%27");"""
"""Script of the page: puts its own address into the command. Servers allow it by its hash; without it, the command
holds a placeholder."""


def pictures_of(files: list[Path]) -> list[bytes]:
    """A few frames of a split as small JPEG images: the middle frames of sequences spaced evenly among all."""
    n = min(PICTURES, len(files))
    chosen = [files[round(k * (len(files) - 1) / max(n - 1, 1))] for k in range(n)]
    return [picture for path in chosen if (picture := middle_frame(path)) is not None]


def middle_frame(path: Path) -> bytes | None:
    """The middle frame of a sequence's first camera as JPEG; None where it has no camera or no frame."""
    sequence = open_sequence(path)
    camera = next(iter(sequence.cameras), None)
    stamps = [] if camera is None else [image.stamp_ns for image in sequence.images(camera)]
    if camera is None or not stamps:
        return None
    middle = stamps[len(stamps) // 2]
    image = next(sequence.images(camera, middle, middle + 1))
    height, width = image.pixels.shape[:2]
    size = (min(WIDTH, width), round(height * min(WIDTH, width) / width))
    small = cv2.resize(image.pixels, size, interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return data.tobytes() if done else None


def index_page(index: Index, public: str) -> str:
    """Render the page of an index, signed with the key whose public half is given. Links and images are relative, so it
    works from any address and from a folder."""
    releases = [release for _, versions in sorted(index.splits.items()) for release in reversed(versions.values())]
    models = [release for _, versions in sorted(index.models.items()) for release in reversed(versions.values())]
    context = {
        "releases": releases,
        "models": models,
        "splits": len(index.splits),
        "total": human(sum(release.size for release in releases)),
        "human": human,
        "key": public,
        "script": Markup(SCRIPT),
    }
    return render("hub.html", context, "oysterbench.hub")


def human(size: int) -> str:
    """Format a number of bytes for people, in decimal units."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= scale:
            return f"{size / scale:.1f} {unit}"
    return f"{size} bytes"
