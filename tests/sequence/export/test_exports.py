"""What holds of exports in every format."""

from __future__ import annotations

import json

import pytest

import oysterbench
from oysterbench.core.errors import SequenceError
from oysterbench.sequence.export import export_sequence


def test_nothing_is_overwritten(sequence, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    with pytest.raises(SequenceError, match="already exists and was left unchanged"):
        export_sequence(sequence, "kalibr", tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]


def test_an_export_that_fails_leaves_nothing(dive_file, tmp_path):
    data = bytearray(dive_file.read_bytes())
    data[len(data) // 2] ^= 255  # among the images
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    with pytest.raises(SequenceError, match=r"damaged\.mcap: truncated or damaged"):
        export_sequence(oysterbench.open(damaged), "euroc", tmp_path / "out" / "here")
    assert list((tmp_path / "out").iterdir()) == []


def test_an_unknown_format_is_named(sequence, tmp_path):
    with pytest.raises(SequenceError, match="unknown format 'pcap'; formats: euroc, tum"):
        export_sequence(sequence, "pcap", tmp_path / "out")


def test_the_documents_are_json_and_yaml_of_others(folders):
    document = json.loads((folders["coco"] / "instances.json").read_text())
    assert set(document) == {"info", "licenses", "images", "annotations", "categories"}
