"""JSON that no reader can hold, or no writer write again, is refused with a reason."""

from __future__ import annotations

import pytest

from oysterbench.core.documents import read_json


def test_json_is_read():
    assert read_json(b'\xef\xbb\xbf{"a": [1, "\\ud83e\\uddaa"]}') == read_json('{"a": [1, "\U0001f9aa"]}')


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (b"[" * 100_000 + b"]" * 100_000, "nested too deep"),
        (b"9" * 5000, "^it has a number of too many digits$"),
        (b'{"a": "\\ud800"}', "surrogates not allowed"),
        (b'{"\\uDfff": 1}', "surrogates not allowed"),
        (b'"\xed\xa0\x80"', "can't decode byte"),
        (b"{", "Expecting property name"),
        (b"", "Expecting value"),
    ],
)
def test_what_is_wrong_with_a_document_is_a_value_error(data, cause):
    with pytest.raises(ValueError, match=cause):
        read_json(data)
