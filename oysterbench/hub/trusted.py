"""Manifests that a client trusts: those that ship with oysterbench, and those that a signed index named.

The latter are remembered in the home folder, as `hub/manifests/<SHA-256 of the manifest>`: a manifest beside files on
disk may be anybody's, and only its hash tells whether a key ever vouched for it.
"""

from __future__ import annotations

from pathlib import Path

from oysterbench.core.files import home, write_atomically
from oysterbench.hub.manifest import Manifest, released_manifest


def remember(manifest: Manifest, public: str) -> None:
    """Remember that an index signed with this key (hex) named the manifest."""
    path = _memory(manifest)
    if not path.is_file():
        write_atomically(path, f"{public}\n".encode())


def is_trusted(manifest: Manifest) -> bool:
    """Whether the manifest ships with oysterbench, or a signed index named it on this machine."""
    return released_manifest(manifest.split, manifest.version) == manifest or _memory(manifest).is_file()


def _memory(manifest: Manifest) -> Path:
    return home() / "hub" / "manifests" / manifest.sha256
