"""JSON of anybody's making."""

from __future__ import annotations

import json
from typing import Any


def read_json(data: bytes | str) -> Any:
    """The value of a document in UTF-8. Raises ValueError for whatever is wrong with it: nested too deep for a reader,
    a number of too many digits, a text that is no Unicode and that nothing could write again."""
    text = data if isinstance(data, str) else data.decode("utf-8-sig")
    try:
        value = json.loads(text)
        if "\\ud" in text or "\\uD" in text:  # halves of surrogate pairs, which may stand alone
            json.dumps(value, ensure_ascii=False).encode()
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except ValueError as error:
        if "integer string conversion" in str(error):  # which goes on with advice to whoever runs Python
            raise ValueError("it has a number of too many digits") from None
        raise
    return value
