"""The hub's page: what there is to download, with pictures and sizes. It is a file of the tree like the others."""

from __future__ import annotations

from html import escape
from pathlib import Path

import cv2

from oysterbench.core.page import page
from oysterbench.hub.index import Index, Release
from oysterbench.sequence import open_sequence

PICTURES = 3
WIDTH = 640  # px
QUALITY = 85

STYLE = """
<style>
.splits { display: grid; gap: 1.2rem; margin: 1.4rem 0; }
.splits .card { padding-bottom: .9rem; }
.splits h2 { margin: 0 0 .2rem; }
.splits .frames { margin: .8rem 0; }
.splits pre { margin: .7rem 0; }
.tag { font-size: .8rem; font-weight: 500; padding: .1rem .5rem; border: 1px solid var(--line); border-radius: 99px;
  margin-left: .5rem; vertical-align: middle; color: var(--soft); }
a { color: var(--c1); overflow-wrap: anywhere; }
</style>
"""


def pictures_of(files: list[Path]) -> list[bytes]:
    """A few frames of a split as small JPEG images: the middle frame of sequences that lie evenly among all."""
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
    """The page of an index, signed with the key whose public half is given; links and pictures are relative, so that it
    works from any address and from a folder."""
    cards = "\n".join(
        _card(name, version, release)
        for name, versions in sorted(index.splits.items())
        for version, release in reversed(versions.items())
    )
    total = sum(release.size for versions in index.splits.values() for release in versions.values())
    splits = "1 split" if len(index.splits) == 1 else f"{len(index.splits)} splits"
    lead = f"{splits}, {human(total)}. Rendered data, licence CC BY 4.0."
    return page(
        "oysterbench hub",
        f"""{STYLE}<h1>Oyster reefs for underwater robots</h1>
<p class="lead">{lead} Every byte is checked on the way, and an interrupted download goes on where it was.</p>
<div class="splits">
{cards}
</div>
<section class="card">
<h2>Downloading from here</h2>
<pre>export OYSTERBENCH_HUB=(the address of this page)
export OYSTERBENCH_HUB_KEY={public}</pre>
<p class="small">The key signs <a href="index.json">index.json</a>, which names every file by its hash. Before you trust
it, compare it with what the hub's owner published elsewhere: a false page would name a false key.</p>
</section>""",
    )


def _card(name: str, version: str, release: Release) -> str:
    pictures = "".join(
        f'<figure><img src="pictures/{digest}.jpg" alt="A frame of {escape(name)}" loading="lazy"></figure>'
        for digest in release.pictures
    )
    hidden = '<span class="tag">truth kept back</span>' if release.hidden else ""
    plural = "" if release.sequences == 1 else "s"
    return f"""<section class="card">
<h2>{escape(name)} {escape(version)}<span class="tag">{escape(release.track)}</span>{hidden}</h2>
<p>{escape(release.summary)}</p>
<p class="small">{release.sequences} sequence{plural}, {human(release.size)}, released {escape(release.published)}</p>
<div class="frames">{pictures}</div>
<pre>oysterbench download {escape(name)}@{escape(version)}</pre>
<p class="small"><a href="manifests/{release.manifest}.json">manifest</a> ·
<a href="croissant/{release.croissant}.json">Croissant metadata</a></p>
</section>"""


def human(size: int) -> str:
    """A number of bytes for people, in decimal units."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= scale:
            return f"{size / scale:.1f} {unit}"
    return f"{size} bytes"
