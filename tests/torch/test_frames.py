"""Frames with their masks: the same as the sequence reads, in any process, and one clear line where they cannot be."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import oysterbench
from oysterbench.core.errors import OptionError, SequenceError
from oysterbench.sequence.export import export_sequence
from oysterbench.sequence.places import Chunks, IndexedFile
from oysterbench.torch import FrameDataset

LAYERS = ("oyster", "ignore", "class", "instance", "depth", "visibility")


def mean_of_image(item):
    """A transform that spawned workers can have: of a module, and no lambda."""
    return {"mean": item["image"].float().mean(), "name": item["name"]}


def test_items_are_what_the_sequence_reads(dive_file):
    frames = FrameDataset(dive_file, layers=LAYERS)
    sequence = oysterbench.open(dive_file)
    read = {layer: list(sequence.layer("cam_left", layer)) for layer in ("class", "instance", "depth", "visibility")}
    images = {image.stamp_ns: image.pixels for image in sequence.images("cam_left")}
    assert len(frames) == len(read["class"]) == 4, "the frames that have layers, and no camera without"
    for k, item in enumerate(frames):
        assert item["stamp_ns"] == read["class"][k].stamp_ns
        assert np.array_equal(item["image"].numpy().transpose(1, 2, 0), images[item["stamp_ns"]])
        for layer, planes in read.items():
            assert np.array_equal(item[layer].numpy(), planes[k].pixels, equal_nan=layer == "visibility")
        assert np.array_equal(item["oyster"].numpy(), read["class"][k].pixels == 2)
        assert item["name"] == frames.names[k] == f"hand-made/cam_left/{item['stamp_ns']}"
        assert item["intrinsics"].numpy() == pytest.approx(sequence.cameras["cam_left"].matrix)


def test_what_evaluators_leave_out_is_ignored(dive_file):
    labelled = oysterbench.labelled(dive_file)
    for item, image in zip(FrameDataset(dive_file, layers=("ignore",)), labelled, strict=True):
        assert item["name"] == image.name
        assert np.array_equal(item["ignore"].numpy(), image.ignore)


def test_tensors_are_as_documented(dive_file):
    item = FrameDataset(dive_file, layers=LAYERS)[0]
    documented = dict(re.findall(r"^    (\w+) +(\(.*?\) \w+|int) ", FrameDataset.__doc__, re.M))
    sizes = {"H": 48, "W": 64}
    for key in ("image", "intrinsics", *LAYERS):
        shape, kind = re.fullmatch(r"\((.*)\) (\w+)", documented[key]).groups()
        assert item[key].dtype == getattr(torch, kind), key
        assert tuple(item[key].shape) == tuple(sizes.get(size) or int(size) for size in shape.split(", ")), key


def test_images_alone_are_those_of_every_camera(dive_file):
    frames = FrameDataset(dive_file, layers=())
    assert len(frames) == 40
    assert {item["camera"] for item in frames} == {"cam_left", "cam_right"}
    assert len(FrameDataset([dive_file, dive_file], camera="cam_right", layers=())) == 40


def test_an_item_reads_the_chunks_that_hold_it_and_no_other(dive_file, monkeypatch):
    frames = FrameDataset(dive_file, layers=("class", "depth"))
    read = []
    whole = IndexedFile.read
    monkeypatch.setattr(IndexedFile, "read", lambda self, offset: read.append(offset) or whole(self, offset))
    frames[3]
    assert len(read) == 3, "one chunk of the image, the class and the depth each"
    frames[-1]
    assert len(read) == 3, "it is kept"


def test_no_more_is_kept_than_was_asked_for(dive_file):
    chunks = Chunks(1)
    file = IndexedFile(dive_file, ["/imu", "/cam_left/image"], chunks)
    for topic in ("/imu", "/cam_left/image", "/imu"):
        file.message(topic, 0)
    assert len(chunks._kept) == 1


@pytest.mark.parametrize("method", [pytest.param("spawn", marks=pytest.mark.slow), "fork"])
def test_workers_give_the_same_items(dive_file, method):
    frames = FrameDataset(dive_file, layers=("oyster",), transform=mean_of_image)
    frames[0]  # what is kept here is no hindrance to other processes
    context = multiprocessing.get_context(method)
    loader = DataLoader(frames, batch_size=2, num_workers=2, multiprocessing_context=context)
    found = {name: float(mean) for batch in loader for name, mean in zip(batch["name"], batch["mean"], strict=True)}
    assert found == {item["name"]: float(item["mean"]) for item in frames}


def test_a_data_set_is_pickled_without_what_it_has_read(dive_file):
    frames = FrameDataset(dive_file)
    before = len(pickle.dumps(frames))
    frames[0]
    data = pickle.dumps(frames)
    assert len(data) == before
    assert torch.equal(pickle.loads(data)[2]["image"], frames[2]["image"])


def test_a_file_that_vanishes_is_named(own_dive):
    frames = FrameDataset(own_dive)
    own_dive.unlink()
    with pytest.raises(SequenceError, match=r"dive.mcap: no longer exists; .* render or download it again"):
        frames[0]
    loader = DataLoader(frames, num_workers=1, multiprocessing_context="fork")
    with pytest.raises(SequenceError, match="no longer exists"):
        next(iter(loader))


def test_a_file_that_was_replaced_is_named(own_dive):
    frames = FrameDataset(own_dive)
    own_dive.write_bytes(own_dive.read_bytes() + b" ")
    with pytest.raises(SequenceError, match="has changed since it was opened"):
        frames[0]


def test_damage_is_found_where_it_is_read(own_dive):
    frames = FrameDataset(own_dive, layers=("class",))
    at = int(frames._parts[0].shots.file.topics["/cam_left/class"].chunks[0])
    data = bytearray(own_dive.read_bytes())
    data[at + 90] ^= 1  # of the packed records, behind the header of the chunk
    stat = own_dive.stat()
    own_dive.write_bytes(data)
    os.utime(own_dive, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    with pytest.raises(SequenceError, match="truncated or damaged"):
        frames[0]


def test_files_without_labels_are_refused_in_one_line(dive_file, tmp_path):
    folder, _ = export_sequence(oysterbench.open(dive_file), "mcap", tmp_path / "blind", truth=False)
    (blind,) = folder.glob("*.mcap")
    with pytest.raises(SequenceError, match=r"cam_left has none: its truth is kept back.*layers=\(\)") as raised:
        FrameDataset(blind)
    assert "\n" not in str(raised.value)
    assert len(FrameDataset(blind, layers=())) == 40


@pytest.mark.parametrize(
    ("options", "pattern"),
    [
        (
            {"layers": ("oyster", "flow")},
            "expected a camera with the layers oyster, flow; cam_left has .*oyster, ignore",
        ),
        ({"layers": ("masks",)}, "unknown layer 'masks'; known layers: oyster, ignore, depth"),
        ({"camera": "cam_down"}, "no camera 'cam_down'; cameras: cam_left, cam_right"),
        ({"camera": "cam_right"}, "cam_right has none"),
        ({"camera": []}, "camera: expected a name or several, got none"),
        ({"camera": 3}, "camera: expected a name or several, got 3"),
        ({"layers": None}, "layers: expected a name or several, got None"),
        ({"layers": [3]}, r"layers: expected a name or several, got \[3\]"),
    ],
)
def test_what_a_file_has_not_is_refused_in_one_line(dive_file, options, pattern):
    with pytest.raises((SequenceError, OptionError), match=pattern):
        FrameDataset(dive_file, **options)


def test_numbers_beyond_the_end_are_refused(dive_file):
    with pytest.raises(IndexError, match="expected an item from 0 to 3, got 4"):
        FrameDataset(dive_file)[4]


def test_without_torch_there_is_one_line_that_says_what_to_type():
    code = """
import sys
sys.modules["torch"] = None
import oysterbench
try:
    oysterbench.torch
except ImportError as error:
    assert isinstance(error, oysterbench.OysterbenchError)
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.endswith("type: pip install 'oysterbench[learn]'\n")
    assert done.stdout.count("\n") == 1
