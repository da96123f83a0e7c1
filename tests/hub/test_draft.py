"""What a killed process leaves of the pieces under way: used when it is right, harmless when it is not."""

from __future__ import annotations

import pytest

from oysterbench.hub.draft import HEADER, drafts_left
from tests.helpers.blobs import blob, fetch
from tests.helpers.web import Honest, serving

DATA, ENTRY = blob(100_001)
PATH = f"blobs/{ENTRY.sha256}"
START, END = ENTRY.span(2)


def leave(folder, content, own="0123abcd", piece=2, filled=None):
    """A draft as a killed process leaves it, beside the part of `file`."""
    path = folder / f"file.part.{own}.draft"
    path.write_bytes(HEADER.pack(piece, len(content) if filled is None else filled) + content)
    return path


def fetched(folder):
    """Have the file, from an honest server; what was asked of it, and the mirrors' failures."""
    with serving(Honest, {PATH: DATA}) as site:
        (mirror,) = fetch(ENTRY, folder / "file", [site.url], connections=2)
    assert (folder / "file").read_bytes() == DATA
    assert [path.name for path in folder.iterdir()] == ["file"]
    assert mirror.failure is None
    return sum(end - start for _, start, end in site.requests)


def test_a_piece_goes_on_from_its_beginning(tmp_path):
    leave(tmp_path, DATA[START : START + 7000])
    assert fetched(tmp_path) == len(DATA) - 7000


def test_of_a_whole_piece_one_byte_is_fetched(tmp_path):
    leave(tmp_path, DATA[START:END])
    assert fetched(tmp_path) == len(DATA) - (END - START) + 1


@pytest.mark.parametrize("length", [7000, END - START])
def test_a_wrong_beginning_costs_one_piece_and_no_mirror_its_name(tmp_path, length):
    leave(tmp_path, bytes(length))
    assert len(DATA) < fetched(tmp_path) <= len(DATA) + END - START


@pytest.mark.parametrize(
    ("header", "content"),
    [
        (b"", b""),
        (HEADER.pack(2, 7000), b""),
        (HEADER.pack(2, -1), b"x" * 50),
        (HEADER.pack(-2, 50), b"x" * 50),
        (HEADER.pack(10**9, 50), b"x" * 50),
    ],
    ids=["empty", "cut", "less than nothing", "no piece", "a piece that is not"],
)
def test_a_draft_that_makes_no_sense_is_no_harm(tmp_path, header, content):
    (tmp_path / "file.part.0123abcd.draft").write_bytes(header + content)
    assert fetched(tmp_path) == len(DATA)


def test_of_two_beginnings_the_longer_is_used_and_the_other_deleted(tmp_path):
    short = leave(tmp_path, DATA[START : START + 10], own="ffffffff")
    long = leave(tmp_path, DATA[START : START + 9000], own="00000000")
    assert drafts_left(tmp_path / "file.part") == {2: long}
    assert not short.exists()
    assert fetched(tmp_path) == len(DATA) - 9000


def test_the_beginning_of_a_piece_that_is_there_is_deleted(tmp_path):
    leave(tmp_path, DATA[START : START + 10])
    (tmp_path / "file.part").write_bytes(DATA)
    assert fetched(tmp_path) == 0
