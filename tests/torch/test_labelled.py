"""Labelled pictures as tensors: what a labelled set reads, in any process, and one line where they cannot be."""

from __future__ import annotations

import numpy as np
import pytest
from torch.utils.data import DataLoader

import oysterbench
from oysterbench.annotations import write_folder
from oysterbench.core.errors import LabelError
from oysterbench.torch import LabelledDataset
from tests.helpers.labelled_folders import image, yolo_folder


@pytest.fixture
def folder(tmp_path):
    """Five pictures of two clips with masks and instances, some of which are for training."""
    images = [image(seed, "ab"[seed % 2]) for seed in range(5)]
    write_folder(images, tmp_path / "real", {one.name: "train" if one.clip == "a" else "test" for one in images})
    return tmp_path / "real"


def test_items_are_what_the_set_reads(folder):
    pictures = LabelledDataset(folder)
    assert len(pictures) == 5
    for item, read in zip(pictures, oysterbench.labelled(folder), strict=True):
        assert np.array_equal(item["image"].numpy().transpose(1, 2, 0), read.pixels)
        assert np.array_equal(item["oyster"].numpy(), read.oysters)
        assert np.array_equal(item["instance"].numpy(), read.instances)
        assert np.array_equal(item["ignore"].numpy(), read.ignore)
        assert (item["name"], item["clip"]) == (read.name, read.clip)


def test_a_part_of_a_set_is_a_data_set(folder):
    part = oysterbench.labelled(folder).of_split("train")
    assert [item["clip"] for item in LabelledDataset(part)] == ["a"] * 3


def test_one_item_is_had_by_its_number(folder):
    pictures = LabelledDataset(folder)
    assert pictures[-1]["name"] == pictures[np.int64(4)]["name"] == oysterbench.labelled(folder)[4].name
    with pytest.raises(IndexError, match="expected an item from 0 to 4, got 5"):
        pictures[5]
    with pytest.raises(TypeError, match=r"Subset\(data, numbers\) has several"):
        pictures[0:2]


def test_a_split_is_a_data_set_too(dive_file):
    split = oysterbench.split(dive_file.parent)
    assert [item["name"] for item in LabelledDataset(split)] == [one.name for one in split.labelled()]


def test_workers_give_the_same_items(folder):
    pictures = LabelledDataset(folder)
    loader = DataLoader(pictures, batch_size=5, num_workers=2, multiprocessing_context="fork")
    (batch,) = loader
    assert batch["name"] == [item["name"] for item in pictures]
    assert np.array_equal(batch["image"][4], pictures[4]["image"])


def test_polygons_become_masks(tmp_path):
    square = "0 0.25 0.25 0.75 0.25 0.75 0.75 0.25 0.75\n"
    pictures = LabelledDataset(yolo_folder(tmp_path / "yolo", {"one": square}))
    assert pictures[0]["oyster"].float().mean() == pytest.approx(0.25, abs=0.05)


def test_a_folder_without_labels_is_refused_in_one_line(tmp_path):
    with pytest.raises(LabelError, match="expected a sequence file") as raised:
        LabelledDataset(tmp_path)
    assert "\n" not in str(raised.value)
