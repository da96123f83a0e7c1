"""JSON from untrusted sources."""

from __future__ import annotations

import json
from typing import Any


def read_json(data: bytes | str) -> Any:
    """Parse a JSON document in UTF-8. Raises ValueError for anything wrong with it, including nesting too deep for the
    parser, a number with too many digits, and text that is not valid Unicode and so could not be written again."""
    text = data if isinstance(data, str) else data.decode("utf-8-sig")
    try:
        value = json.loads(text)
        if "\\ud" in text or "\\uD" in text:  # surrogates, which may be unpaired
            json.dumps(value, ensure_ascii=False).encode()
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except ValueError as error:
        if "integer string conversion" in str(error):  # the message goes on with advice to whoever runs Python
            raise ValueError("it has a number of too many digits") from None
        raise
    return value
