"""The layout for Foxglove: what it names is in the file, in a form that the panel takes."""

from __future__ import annotations

import json

import pytest

import oysterbench
from oysterbench.core.errors import SequenceError
from oysterbench.core.ros import decode
from oysterbench.sensors.camera_messages import LAYERS
from oysterbench.sequence.export import export_sequence
from oysterbench.sequence.export.foxglove import LAYOUT, PANEL_SCHEMAS, SHOWN_ENCODINGS, layout
from oysterbench.sequence.read import read_messages

NUMBERS = (int, float)


@pytest.fixture(scope="module")
def sequence(dive_file):
    return oysterbench.open(dive_file)


@pytest.fixture(scope="module")
def made(sequence):
    return layout(sequence)


def panels(made, kind):
    return {key: config for key, config in made["configById"].items() if key.startswith(f"{kind}!")}


def plotted(made):
    for config in panels(made, "Plot").values():
        yield from (path["value"] for path in config["paths"])
        if "xAxisPath" in config:
            yield config["xAxisPath"]["value"]


def test_every_picture_is_a_topic_of_a_type_that_the_panel_shows(sequence, made):
    modes = [config["imageMode"] for config in panels(made, "Image").values()]
    assert {mode["imageTopic"] for mode in modes} == {
        "/cam_left/image", "/cam_right/image", "/cam_left/depth", "/cam_left/class", "/cam_left/instance",
        "/cam_left/visibility", "/fls/image",
    }  # fmt: skip
    for mode in modes:
        assert sequence.types[mode["imageTopic"]] in PANEL_SCHEMAS["Image"]
        if "calibrationTopic" in mode:
            assert sequence.types[mode["calibrationTopic"]] in PANEL_SCHEMAS["calibration"]
        leaf = mode["imageTopic"].rpartition("/")[2]
        assert LAYERS.get(leaf, "mono8") in SHOWN_ENCODINGS
        assert mode.get("maxValue", 1) > 0


def test_the_scene_shows_topics_of_types_that_it_takes_in_frames_that_there_are(sequence, made):
    (scene,) = panels(made, "3D").values()
    assert {"/truth/pose", "/fls/cloud", "/cam_left/camera_info"} <= scene["topics"].keys()
    for topic in scene["topics"]:
        assert sequence.types[topic] in PANEL_SCHEMAS["3D"]
    frames = {"map"}
    for message in read_messages(sequence.path, ["/tf", "/tf_static"]):
        found = decode(message.data, sequence.types[message.topic]).transforms
        frames |= {transform.child_frame_id for transform in found}
    assert {scene["followTf"], scene["fixedFrame"], scene["layers"]["grid"]["frameId"]} <= frames


def test_every_curve_is_a_number_of_a_message(sequence, made):
    paths = list(plotted(made))
    topics = {path.partition(".")[0] for path in paths}
    assert topics == {
        "/imu", "/truth/odometry", "/dvl/velocity", "/dvl/altitude", "/pressure", "/magnetometer", "/alt/range",
    }  # fmt: skip
    firsts = {topic: next(iter(read_messages(sequence.path, [topic]))) for topic in topics}
    for path in paths:
        topic, *fields = path.split(".")
        value = decode(firsts[topic].data, sequence.types[topic])
        for field in fields:
            value = getattr(value, field)
        assert isinstance(value, NUMBERS), path


def test_each_panel_stands_at_one_place(made):
    def leaves(node):
        if isinstance(node, str):
            yield node
            for tab in made["configById"][node].get("tabs", []):
                yield from leaves(tab["layout"])
        else:
            assert node["direction"] in ("row", "column")
            assert 0 < node["splitPercentage"] < 100
            yield from leaves(node["first"])
            yield from leaves(node["second"])

    assert sorted(leaves(made["layout"])) == sorted(made["configById"])


def test_the_format_puts_the_file_and_its_layout_into_one_folder(sequence, made, tmp_path):
    folder, notes = export_sequence(sequence, "foxglove", tmp_path / "out")
    assert sorted(path.name for path in folder.iterdir()) == [LAYOUT, "hand-made.mcap"]
    assert json.loads((folder / LAYOUT).read_text()) == made
    assert "Import from file" in notes[-1]


def test_without_truth_the_layout_names_none(sequence, tmp_path):
    folder, _ = export_sequence(sequence, "foxglove", tmp_path / "blind", truth=False)
    text = (folder / LAYOUT).read_text()
    assert not [word for word in ("/truth", "/tf", "depth", "cloud", '"map"') if word in text]
    there = oysterbench.open(folder / "hand-made.mcap").types
    made = json.loads(text)
    assert {path.partition(".")[0] for path in plotted(made)} <= there.keys()
    (scene,) = panels(made, "3D").values()
    assert scene["topics"].keys() <= there.keys()


def test_a_layout_is_of_a_sequence_file(sequence, tmp_path):
    folder, _ = export_sequence(sequence, "euroc", tmp_path / "euroc")
    with pytest.raises(SequenceError, match=r"topics of a sequence file \(\.mcap\), and this is not one"):
        layout(oysterbench.open(folder))
