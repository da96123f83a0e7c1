"""Text of strangers: JSON, what reaches a terminal, and names that look like others."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oysterbench.core.text import disguised, mixed_word, printable, read_json, unseen
from oysterbench.report.renderers.csv import field

HOSTILE = "a\x1b]0;title\x07\x9b2Jb\r\u202ec\u3164\U000e0041"


@given(st.text())
def test_nothing_but_signs_lines_and_tabs_is_printed_and_json_keeps_its_values(text):
    assert all(c.isprintable() or c in "\n\t" for c in printable(text))
    assert json.loads(printable(json.dumps(text, ensure_ascii=False))) == text


def test_what_a_terminal_obeys_is_written_out():
    assert printable(HOSTILE).startswith("a\\u001b]0;title\\u0007\\u009b2Jb\\r\\u202ec")


@pytest.mark.parametrize(
    "odd", ["\u3164", "\u00ad", "\u034f", "\U000e0041", "\u061c", "\u200b", "\ufe0f", "\u2003", "\x9b"]
)
def test_what_nobody_sees_is_found(odd):
    assert unseen(f"reef{odd} lab") == odd


NAMES = ["reef lab", "Łódź team", "小組", "naïve café", "команда", "α-SLAM v2.1 (mono)", "100 ± 5 µm – m²"]


@pytest.mark.parametrize("name", NAMES)
def test_names_of_all_scripts_are_names(name):
    assert unseen(name) is None
    assert mixed_word(name) is None
    assert disguised(name) is None


@pytest.mark.parametrize("name", ["ORB-SL\u0410M", "c\u043ed", "\u039dET", "\u13a0RB"])
def test_words_of_letters_that_look_like_latin_ones_are_found(name):
    assert mixed_word(name) == name.rpartition("-")[2]


@pytest.mark.parametrize("text", ["=1", "\uff1d1", "\ufe0f=1", " \u3164=1", "+1", "\uff0b1", "@x", "\ufe62x"])
def test_no_cell_begins_a_formula(text):
    assert field(text) == f"'{text}"


@pytest.mark.parametrize("name", ["\uff23arp", "\U0001d402arp", "pro\ufb01le", "\u24b8arp", "carp \uff11"])
def test_common_letters_in_another_cut_are_found(name):
    assert disguised(name) is not None


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
