"""Canonical JSON, so that the hash of a document can be its name; and checked decoding of documents."""

from __future__ import annotations

import hashlib
import json
import re
from typing import Annotated, Any, TypeVar

import msgspec

from oysterbench.core.errors import IntegrityError

T = TypeVar("T")

SHA256 = re.compile("[0-9a-f]{64}")
Sha256 = Annotated[str, msgspec.Meta(pattern=rf"^{SHA256.pattern}\Z")]
"""A SHA-256 hash, 64 hex digits."""


def canonical(document: Any) -> bytes:
    """Encode a document as UTF-8: keys sorted, no spaces, one line break at the end; NaN and infinity are refused."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.encode() + b"\n"


def sha256(data: bytes | memoryview) -> str:
    """SHA-256 of some bytes, 64 hex digits."""
    return hashlib.sha256(data).hexdigest()


def decode(data: bytes, kind: type[T], what: str) -> T:
    """Decode a document of a kind. Raises IntegrityError naming `what`, what was expected, what was got and at which
    key."""
    try:
        return msgspec.json.decode(data, type=kind)
    except msgspec.ValidationError as error:
        newer = "; another version of oysterbench is needed to read it" if "`$.format`" in str(error) else ""
        raise IntegrityError(f"{what}: {error}; it was not used{newer}") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise IntegrityError(f"{what}: expected JSON, got {data[:40]!r} ({error}); it was not used") from None


def parse(data: bytes, what: str) -> dict[str, Any]:
    """Decode a JSON object of any kind. Raises IntegrityError naming `what` where it is none."""
    return decode(data, dict[str, Any], what)
