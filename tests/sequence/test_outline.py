"""What is told of a sequence before it is read: its length, the rates of its topics, and whether it has true poses."""

from __future__ import annotations

import pytest
from mcap.reader import make_reader

import oysterbench
from oysterbench import sequence as sequences
from oysterbench.sequence.export import export_sequence
from oysterbench.sequence.truth import TRUTH
from tests.helpers.command import assert_one_line, run


def test_rates_are_over_the_time_of_each_topic(dive_file):
    """Clocks may differ: the span of all topics together is no measure of the rate of one."""
    sequence = oysterbench.open(dive_file)
    rates = sequence.rates()
    assert (rates["/imu"], rates["/cam_left/image"]) == pytest.approx((100.0, 10.0))
    assert rates["/tf_static"] is None
    assert sequence.for_method().rates() == {topic: rates[topic] for topic, _, _ in sequence.for_method().contents()}
    told = {row["topic"]: row["rate_hz"] for row in sequences.describe(dive_file)["topics"]}
    assert (told["/imu"], told["/cam_left/image"], told["/tf_static"]) == (100.0, 10.0, None)


@pytest.mark.parametrize(("length_m", "told"), [(0.0, "0.00 m of path"), (None, "no true path")])
def test_info_tells_a_path_of_no_length_from_none(dive_file, monkeypatch, length_m, told):
    facts = {**sequences.describe(dive_file), "path_length_m": length_m}
    monkeypatch.setattr(sequences, "describe", lambda path: facts)
    assert run("info", dive_file).stdout.startswith(f"hand-made: 1.99 s, {told}\n")


def test_info_of_a_file_with_damaged_true_poses_says_that_it_is_damaged(dive_file, tmp_path):
    data = bytearray(dive_file.read_bytes())
    with open(dive_file, "rb") as file:
        summary = make_reader(file).get_summary()
    (channel,) = [channel.id for channel in summary.channels.values() if channel.topic == TRUTH]
    index = next(index for index in summary.chunk_indexes if channel in index.message_index_offsets)
    data[index.chunk_start_offset + index.chunk_length // 2] ^= 255
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    assert_one_line(run("info", path), "damaged[.]mcap: truncated or damaged")


@pytest.mark.parametrize("truth", [True, False])
def test_a_folder_in_euroc_layout_says_whether_it_has_true_poses(dive_file, tmp_path, truth):
    folder, _ = export_sequence(oysterbench.open(dive_file), "euroc", tmp_path / "euroc", truth)
    sequence = oysterbench.open(folder)
    assert sequence.has_truth == truth
    assert repr(sequence).endswith("imu; truth>" if truth else "imu; no truth>")
    assert repr(sequence.for_method()).endswith("imu; no truth>")
