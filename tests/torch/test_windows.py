"""Windows of frames: images, the inertial samples between them, and how the body truly moved."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import oysterbench
from oysterbench.core.errors import OptionError, SequenceError
from oysterbench.sequence.export import export_sequence
from oysterbench.torch import WindowDataset
from tests.helpers.hand_made_dive import pose


@pytest.fixture(scope="module")
def windows(dive_file):
    return WindowDataset(dive_file, length=4, stride=3)


def test_windows_begin_every_stride_and_are_whole(windows, dive_file):
    stamps = [image.stamp_ns for image in oysterbench.open(dive_file).images("cam_left")]
    assert len(windows) == 6  # from frames 0, 3, ..., 15 of 20
    for k, item in enumerate(windows):
        assert item["stamp_ns"].tolist() == stamps[3 * k : 3 * k + 4]


def test_images_are_what_the_sequence_reads(windows, dive_file):
    images = [image.pixels for image in oysterbench.open(dive_file).images("cam_left")]
    assert np.array_equal(windows[2]["image"].numpy().transpose(0, 2, 3, 1), np.stack(images[6:10]))


def test_inertial_samples_are_those_after_a_frame_up_to_the_next(windows, dive_file):
    item = windows[1]
    sequence = oysterbench.open(dive_file)
    for t in range(3):
        low, high = item["stamp_ns"][t].item(), item["stamp_ns"][t + 1].item()
        wanted = list(sequence.imu(low + 1, high + 1))
        count = item["imu_count"][t].item()
        assert count == len(wanted) == 10
        assert item["imu_stamp_ns"][t, :count].tolist() == [one.stamp_ns for one in wanted]
        values = [np.concatenate([one.gyro, one.accel]) for one in wanted]
        assert item["imu"][t, :count].numpy() == pytest.approx(np.array(values), rel=1e-6)
        assert not item["imu"][t, count:].any()


def test_relative_poses_take_points_of_the_next_body_into_this_one(windows):
    item = windows[3]
    for t in range(3):
        now, then = pose(1e-1 * (9 + t)), pose(1e-1 * (10 + t))
        assert item["pose"][t].numpy() == pytest.approx(now, abs=1e-6)
        assert item["relative_pose"][t].numpy() == pytest.approx(np.linalg.inv(now) @ then, abs=1e-6)
    ahead = item["relative_pose"][0, :3, 3]
    assert ahead[0] == pytest.approx(0.04, rel=1e-3), "0.4 m/s ahead for a tenth of a second"


def test_tensors_are_as_documented(windows):
    documented = dict(re.findall(r"^    (\w+) +(\([^)]*\) \w+) ", WindowDataset.__doc__, re.M))
    item = windows[0]
    sizes = {"T": 4, "T - 1": 3, "K": windows.imu_samples, "H": 48, "W": 64}
    assert {key for key, value in item.items() if isinstance(value, torch.Tensor)} == set(documented)
    for key, said in documented.items():
        shape, kind = re.fullmatch(r"\((.*?),?\) (\w+)", said).groups()
        assert item[key].dtype == getattr(torch, kind), key
        assert tuple(item[key].shape) == tuple(sizes.get(size) or int(size) for size in shape.split(", ")), key


def test_batches_are_made_by_the_default_collate_function_in_workers(windows):
    loader = DataLoader(windows, batch_size=3, num_workers=2, multiprocessing_context="fork")
    batches = list(loader)
    assert [tuple(batch["image"].shape) for batch in batches] == [(3, 4, 3, 48, 64)] * 2
    assert torch.equal(batches[1]["imu"][2], windows[5]["imu"])


def test_sequences_that_keep_their_truth_back_have_windows_without_poses(dive_file, tmp_path):
    folder, _ = export_sequence(oysterbench.open(dive_file), "mcap", tmp_path / "blind", truth=False)
    with pytest.raises(SequenceError, match=r"no ground-truth poses \(withheld.*poses=False") as raised:
        WindowDataset(folder, length=2)
    assert "\n" not in str(raised.value)
    windows = WindowDataset(folder, length=2, poses=False)
    assert "pose" not in windows[0]
    assert len(windows) == 19


def test_windows_over_a_gap_are_left_out_where_that_is_asked_for(dive_file):
    assert len(WindowDataset(dive_file, length=2, max_gap_s=0.11)) == 19
    assert len(WindowDataset(dive_file, length=2, max_gap_s=0.1 - 5e-7)) == 19, "a gap as large but for rounding"
    assert len(WindowDataset(dive_file, length=2, max_gap_s=math.inf)) == 19
    with pytest.raises(SequenceError, match="no window of 2 frames"):
        WindowDataset(dive_file, length=2, max_gap_s=0.05)


@pytest.mark.parametrize(
    ("options", "pattern"),
    [
        ({"length": 1}, "length: expected a number of frames from 2 on, got 1"),
        ({"length": 2.5}, "length: expected a number of frames from 2 on, got 2.5"),
        ({"length": 3, "stride": 0}, "stride: expected a number of frames from 1 on, got 0"),
    ],
)
def test_lengths_that_make_no_window_are_refused(dive_file, options, pattern):
    with pytest.raises(OptionError, match=pattern):
        WindowDataset(dive_file, **options)


@pytest.mark.parametrize("several", [slice(0, 2), [0, 1]])
def test_several_items_at_once_are_refused_with_what_has_them(windows, several):
    with pytest.raises(TypeError, match=r"expected the number of an item, got .*; torch.utils.data.Subset"):
        windows[several]
    assert windows[np.int64(1)]["name"] == windows[torch.tensor(1)]["name"] == windows[1]["name"]


def test_what_is_no_source_is_refused_in_one_line(dive_file):
    sequence = oysterbench.open(dive_file)
    with pytest.raises(SequenceError, match="got the open sequence hand-made: give the path of its file"):
        WindowDataset(sequence, length=2)
    with pytest.raises(SequenceError, match=r"expected a split, sequence files \(.mcap\) or folders of them, got int"):
        WindowDataset(3, length=2)
