"""What a client trusts on disk: manifests that ship with oysterbench or that a signed index named, and folders that
were filled here.

The named manifests are remembered in the home folder, as `hub/manifests/<SHA-256 of the manifest>`: a manifest beside
files on disk may be anybody's, and only its hash tells whether a key ever vouched for it. So are the folders, as
`hub/folders/<SHA-256 of manifest and path>`: a good manifest may lie beside files that it is not of.
"""

from __future__ import annotations

import os
from pathlib import Path

from oysterbench.core.atomic import write_atomically
from oysterbench.core.places import home
from oysterbench.hub.canonical import sha256
from oysterbench.hub.manifest import Manifest, released_manifest


def remember(manifest: Manifest, public: str) -> None:
    """Remember that an index signed with this key (hex) named the manifest."""
    path = _memory(manifest)
    if not path.is_file():
        write_atomically(path, f"{public}\n".encode())


def is_trusted(manifest: Manifest) -> bool:
    """Whether the manifest ships with oysterbench, or a signed index named it on this machine."""
    return released_manifest(manifest.split, manifest.version) == manifest or _memory(manifest).is_file()


def remember_folder(folder: Path, manifest: Manifest) -> None:
    """Remember that all files in the folder with a name of the manifest were checked against it and are right."""
    path = _folder_memory(folder, manifest)
    if not path.is_file():
        write_atomically(path, os.fsencode(folder.resolve()) + b"\n")


def was_filled_here(folder: Path, manifest: Manifest) -> bool:
    """Whether the folder's files were checked before, so that one of the right size need not be read again."""
    return _folder_memory(folder, manifest).is_file()


def _folder_memory(folder: Path, manifest: Manifest) -> Path:
    return home() / "hub" / "folders" / sha256(manifest.sha256.encode() + os.fsencode(folder.resolve()))


def _memory(manifest: Manifest) -> Path:
    return home() / "hub" / "manifests" / manifest.sha256
