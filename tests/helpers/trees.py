"""Published trees with hand-made dives in them, small enough to publish in a blink."""

from __future__ import annotations

import json
import random
import threading
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mcap.writer import Writer

from oysterbench.hub.canonical import sha256
from oysterbench.hub.download import Hub
from oysterbench.hub.index import Index, Release
from oysterbench.hub.manifest import FileEntry, Manifest
from oysterbench.hub.publish import publish
from oysterbench.hub.sign import load_key, make_key
from oysterbench.sequence.read import CALIBRATION, METADATA, OYSTERS
from oysterbench.sequence.write import SequenceWriter
from tests.helpers.blobs import CALM
from tests.helpers.hand_made_dive import RIG, all_types, calibration, messages
from tests.helpers.waiting import until

FACTS = {"split": "fake-val", "version": "1.0", "track": "slam", "rig": "hand", "summary": "Two short dives by hand"}
DIGEST = sha256(b"the recipe")
SECRET = sha256(b"the recipe, with a salt")
SEED = "seed = 20261120"
TEXTS = {"split.toml": SEED.encode(), "rig.toml": RIG}

PIECE = 1 << 19
SIZE = 20 * PIECE + 1234
"""Of the large file of `Big`, in bytes."""


def write_sequence(path: Path, name: str, seconds: float = 1.0, digest: str = DIGEST, compress: bool = True) -> Path:
    """A dive as `generate` writes one: with its recipe and the truth inside."""
    path.parent.mkdir(parents=True, exist_ok=True)
    sent, types = messages(seconds), all_types()
    with open(path, "wb") as file:
        writer = SequenceWriter(file, types, compress)
        known = {"sequence": name, "split": FACTS["split"], "split_version": FACTS["version"], "track": "slam"}
        writer.metadata(METADATA, {**known, "rig": "hand", "digest": digest, "generation": "4"})
        writer.attachment(CALIBRATION, "application/json", json.dumps(calibration()).encode())
        writer.attachment("classes.json", "application/json", b"{}")
        for text, data in TEXTS.items():
            writer.attachment(text, "application/toml", data)
        writer.attachment(OYSTERS, "text/csv", b"id,state,x,y,z\n7,live,0.5,0.1,-3.0\n40000,box,0.8,-0.2,-3.0\n")
        for topic in types:
            for message in sent:
                if message.topic == topic:
                    writer.write(message)
            writer.section()
        writer.finish()
    return path


def write_bag(path: Path) -> Path:
    """A sound MCAP file of another program."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start("ros2", "rosbag2")
        channel = writer.register_channel("/notes", "json", writer.register_schema("note", "jsonschema", b"{}"))
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    return path


def write_split(folder: Path, digest: str = DIGEST) -> dict[str, Path]:
    """The two sequences of the split: name -> file."""
    return {
        "dive-01": write_sequence(folder / "dive-01.mcap", "dive-01", 1.0, digest),
        "dive-02": write_sequence(folder / "dive-02.mcap", "dive-02", 0.6, digest),
    }


def a_key(folder: Path):
    """A new signing key and its public half."""
    public = make_key(folder / "key.pem")
    return load_key(folder / "key.pem"), public


def publish_split(tree: Path, files: dict[str, Path], key, **facts: str):
    """Publish, with other facts where given."""
    return publish(tree, {**FACTS, **facts}, files, key, DIGEST)


def publish_secret(tree: Path, truth: Path, files: dict[str, Path], key):
    """Publish as a hidden split."""
    return publish(tree, FACTS, files, key, truth=truth)


class Published:
    """A published split: tree, keys and files."""

    def __init__(self, folder):
        self.folder, self.tree = folder, folder / "tree"
        self.key, self.public = a_key(folder)
        self.files = write_split(folder / "data")
        self.manifest = publish_split(self.tree, self.files, self.key)

    @property
    def site(self):
        """What a web server would have."""
        return tree_bytes(self.tree)


def hub_at(published, *places, key=None):
    """The client of a published split at these places, which waits for nothing."""
    return Hub.at([str(place) for place in places], key or published.public, patience=CALM)


def assert_same(files, published):
    """The files that came are those that were published."""
    assert {name: path.read_bytes() for name, path in files.items()} == {
        name: path.read_bytes() for name, path in published.files.items()
    }


class Big:
    """A published split of one file of random bytes."""

    def __init__(self, folder):
        self.key, self.public = a_key(folder)
        self.data = random.Random(7).randbytes(SIZE)
        pieces = tuple(sha256(self.data[k : k + PIECE]) for k in range(0, SIZE, PIECE))
        self.entry = FileEntry("dive-01.mcap", SIZE, sha256(self.data), pieces, {}, {}, 0, PIECE)
        manifest = Manifest("big", "1.0", "slam", "hand", "random bytes", "0", (self.entry,), piece_size=PIECE)
        facts = {"track": "slam", "summary": "", "hidden": False, "published": "2026-01-01", "croissant": "0" * 64}
        release = Release("big", "1.0", manifest.sha256, len(manifest.data), SIZE, 1, **facts)
        self.files = {
            "index.json": Index().with_release(release).signed_with(self.key),
            f"manifests/{manifest.sha256}.json": manifest.data,
            f"blobs/{self.entry.sha256}": self.data,
        }
        self.blob = f"blobs/{self.entry.sha256}"


def tree_bytes(tree: Path) -> dict[str, bytes]:
    """Every file of a tree by its path."""
    return {str(path.relative_to(tree)): path.read_bytes() for path in sorted(tree.rglob("*")) if path.is_file()}


@contextmanager
def oysterbench_serve(tree: Path, proxies: Sequence[str] = ()):
    """`oysterbench serve` in a thread; gives its address."""
    from oysterbench.hub.serve import application

    with serving_app(application(tree), proxies) as url:
        yield url


@contextmanager
def serving_app(app: Any, proxies: Sequence[str] = ()):
    """An application in a thread, with the settings of our servers; gives its address."""
    import uvicorn

    from oysterbench.hub.connections import server_settings

    server = uvicorn.Server(uvicorn.Config(**server_settings(app, "127.0.0.1", 0, proxies=proxies)))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    until(lambda: server.started or not thread.is_alive())
    assert server.started
    port = server.servers[0].sockets[0].getsockname()[1]
    try:
        yield f"http://127.0.0.1:{port}"
    finally:
        server.should_exit = True
        thread.join()
