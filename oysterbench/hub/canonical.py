"""JSON with one spelling, so that the hash of a document is its name."""

from __future__ import annotations

import hashlib
import json
import re
from typing import Any

from oysterbench.core.errors import IntegrityError

SHA256 = re.compile("[0-9a-f]{64}")


def canonical(document: Any) -> bytes:
    """A document as UTF-8 bytes: keys sorted, no spaces, one line break at the end; NaN and infinity are refused."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.encode() + b"\n"


def sha256(data: bytes | memoryview) -> str:
    """SHA-256 of some bytes, 64 hex digits."""
    return hashlib.sha256(data).hexdigest()


def parse(data: bytes, what: str) -> dict[str, Any]:
    """A JSON object. Raises IntegrityError naming `what` where it is none."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise IntegrityError(f"{what}: expected JSON, got {data[:40]!r} ({error}); it was not used") from None
    if not isinstance(document, dict):
        raise IntegrityError(f"{what}: expected a JSON object, got {type(document).__name__}; it was not used")
    return document
