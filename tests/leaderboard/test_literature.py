"""What others reported: with its source, and apart from every board."""

from __future__ import annotations

import pytest

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.boards.literature import literature, parse_literature


def test_every_number_names_its_data_metric_and_source():
    rows = literature()
    assert len(rows) > 30
    for row in rows:
        assert all((row.track, row.method, row.metric, row.value, row.data, row.source))
        assert not row.url or row.url.startswith("https://")
        assert any(digit.isdigit() for digit in row.value)


def test_every_source_but_one_that_was_not_looked_up_has_an_address():
    assert [row.method for row in literature() if not row.url] == ["OpenVINS"]


def test_coverage_stands_beside_the_errors_of_svin2():
    rows = [row for row in literature("slam") if row.data.startswith("SVIn2")]
    assert len(rows) == 16
    assert all("tracked" in row.note for row in rows)


def test_tracks_are_told_apart():
    assert {row.track for row in literature("segmentation")} == {"segmentation"}
    assert literature("golf") == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[group]", "expected TOML"),
        ("", "expected TOML"),
        (
            '[[group]]\ntrack = "slam"\nrow = [{ method = "a", value = "1" }]',
            "group 1: missing keys metric, data, source",
        ),
        ('[[group]]\ntrack = "slam"\nrank = 1\nrow = [{ method = "a", value = "1" }]', "unknown keys rank"),
        (
            '[[group]]\ntrack = "golf"\nmetric = "a"\ndata = "b"\nsource = "c"\nrow = [{ method = "a", value = "1" }]',
            "expected a track",
        ),
    ],
)
def test_a_row_that_lacks_its_source_is_refused(text, message):
    with pytest.raises(ResultError, match=message):
        parse_literature(text)
