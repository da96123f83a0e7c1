"""Keys of a hub (Ed25519, RFC 8032): the publisher signs the index, the client pins the public key."""

from __future__ import annotations

import os
import re
from pathlib import Path

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from oysterbench.core.errors import HubError

CONTEXT = b"oysterbench hub index\n"
"""Prefix of what is signed, so that a signature made for something else never passes for one of an index."""


def make_key(path: Path) -> str:
    """Write a new private key (PEM, PKCS 8), readable by its owner only, and return the public one in hex.

    Raises HubError where the file already exists: an overwritten key could not be recovered.
    """
    data = Ed25519PrivateKey.generate().private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise HubError(f"{path}: the file already exists; it was left unchanged: choose another name") from None
    with os.fdopen(handle, "wb") as file:
        file.write(data)
        os.fsync(file.fileno())
    return public_hex(load_key(path))


def load_key(path: Path) -> Ed25519PrivateKey:
    """Read a private key from its file. Raises HubError where it is not an Ed25519 key in PEM."""
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), password=None)
    except FileNotFoundError:
        raise HubError(f"{path}: no such key; `oysterbench keygen {path}` makes one") from None
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise HubError(f"{path}: expected a private key as `oysterbench keygen` makes it, got: {error}") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise HubError(f"{path}: expected an Ed25519 key, got another kind; `oysterbench keygen` makes one")
    return key


def public_hex(key: Ed25519PrivateKey) -> str:
    """Public key of a private one, 64 hex digits."""
    return key.public_key().public_bytes_raw().hex()


def sign(key: Ed25519PrivateKey, data: bytes) -> str:
    """Signature of an index's canonical bytes, 128 hex digits."""
    return key.sign(CONTEXT + data).hex()


def is_signed(public: str, data: bytes, signature: str) -> bool:
    """Whether the signature of `data` was made with the key whose public half is `public`."""
    try:
        Ed25519PublicKey.from_public_bytes(bytes.fromhex(public)).verify(bytes.fromhex(signature), CONTEXT + data)
    except (InvalidSignature, ValueError):
        return False
    return True


def check_public(key: str, where: str) -> str:
    """Normalise a public key as given by a user. Raises HubError, naming `where` it was given, unless it is one."""
    if not re.fullmatch("[0-9a-f]{64}", key.strip().lower()):
        raise HubError(
            f"{where}: expected a hub's public key, 64 hex digits as `oysterbench keygen` prints them, got {key!r}"
        )
    return key.strip().lower()
