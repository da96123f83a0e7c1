"""The layout for Foxglove: what it names is in the file, in a form that the panel takes."""

from __future__ import annotations

import copy
import json
from dataclasses import replace

import pandas as pd
import pytest

import oysterbench
from oysterbench.core.errors import SequenceError
from oysterbench.core.ros import decode, stamp_of
from oysterbench.sensors.camera_messages import LAYERS
from oysterbench.sequence.export import export_sequence
from oysterbench.sequence.export.foxglove import LAYOUT, PANEL_SCHEMAS, SHOWN_ENCODINGS, TITLES, layout
from oysterbench.sequence.read import read_messages

NUMBERS = (int, float)

KEYS = {
    "Image": {
        f"imageMode.{key}"
        for key in ("imageTopic", "calibrationTopic", "colorMode", "colorMap", "minValue", "maxValue")
    },
    "3D": {
        *(f"cameraState.{key}" for key in ("distance", "perspective", "phi", "thetaOffset", "fovy", "near", "far",
                                           "target", "targetOffset", "targetOrientation")),
        "followMode", "followTf", "fixedFrame",
        *(f"scene.transforms.{key}" for key in ("showLabel", "lineWidth", "lineColor")),
        "transforms.*.visible",
        *(f"layers.*.{key}" for key in ("visible", "layerId", "instanceId", "label", "size", "divisions", "lineWidth",
                                        "color", "frameId", "position")),
        *(f"topics.*.{key}" for key in ("visible", "type", "arrowScale", "color", "distance", "pointSize", "colorMode",
                                        "colorMap", "colorField", "decayTime")),
    },
    "Plot": {
        *(f"paths.*.{key}" for key in ("value", "enabled", "label", "color", "timestampMethod", "showLine")),
        "xAxisVal", "xAxisPath.value", "xAxisPath.enabled", "axisScalesMode", "xAxisLabel", "yAxisLabel", "minYValue",
        "maxYValue", "isSynced", "showLegend", "legendDisplay", "sidebarDimension",
    },
    "Tab": {"activeTabIdx", "tabs.*.title", "tabs.*.layout"},
}  # fmt: skip
"""Panel -> its keys: all are in foxglove.layouts 0.30, and in Lichtblick 1.28 but for fixedFrame and axisScalesMode."""

NAMED = ("topics", "layers", "transforms")
"""Keys below which keys are names of ours."""


@pytest.fixture(scope="module")
def sequence(dive_file):
    return oysterbench.open(dive_file)


@pytest.fixture(scope="module")
def made(sequence):
    return layout(sequence)


def panels(made, kind):
    return {key: config for key, config in made["configById"].items() if key.startswith(f"{kind}!")}


def leaves(made, node=None, width=1.0, height=1.0):
    """Each panel that holds no others, with its share of the window's width and height."""
    node = made["layout"] if node is None else node
    if isinstance(node, str):
        tabs = made["configById"][node].get("tabs")
        for tab in tabs or ():
            yield from leaves(made, tab["layout"], width, height)
        if not tabs:
            yield node, width, height
        return
    first = node["splitPercentage"] / 100
    for child, share in ((node["first"], first), (node["second"], 1 - first)):
        row = node["direction"] == "row"
        yield from leaves(made, child, width * (share if row else 1), height * (1 if row else share))


def plotted(made):
    for config in panels(made, "Plot").values():
        yield from (path["value"] for path in config["paths"])
        if "xAxisPath" in config:
            yield config["xAxisPath"]["value"]


def test_every_picture_is_a_topic_of_a_type_that_the_panel_shows(sequence, made):
    modes = [config["imageMode"] for config in panels(made, "Image").values()]
    assert {mode["imageTopic"] for mode in modes} == {
        "/cam_left/image", "/cam_right/image", "/cam_left/depth", "/cam_left/instance", "/cam_left/visibility",
        "/fls/image",
    }  # fmt: skip
    for mode in modes:
        assert sequence.types[mode["imageTopic"]] in PANEL_SCHEMAS["Image"]
        if "calibrationTopic" in mode:
            assert sequence.types[mode["calibrationTopic"]] in PANEL_SCHEMAS["calibration"]
        leaf = mode["imageTopic"].rpartition("/")[2]
        assert leaf == "image" or LAYERS[leaf] in SHOWN_ENCODINGS
        assert mode.get("maxValue", 1) > 0


def test_no_layer_is_of_bytes_that_the_panel_draws_as_grey(made):
    """Classes are numbers from 0 to 11 of 255: nobody would see them."""
    assert "mono8" not in SHOWN_ENCODINGS
    assert "class" not in json.dumps(made)


@pytest.mark.parametrize("ids", [[7, 40000], [7], []])
def test_no_instance_is_past_the_end_of_the_colours(sequence, ids):
    """Stones have greater numbers than the oysters of the table, and can be more than they are."""
    few = copy.copy(sequence)
    few.oysters = lambda: pd.DataFrame({"id": ids})
    mode = layout(few)["configById"]["Image!cam_left_instance"]["imageMode"]
    assert mode["maxValue"] == max(int(frame.pixels.max()) for frame in sequence.layer("cam_left", "instance"))


def test_a_calibration_is_named_only_where_the_panels_know_the_lens(sequence, made):
    """With that of a fisheye, the image panel shows no picture."""
    assert made["configById"]["Image!cam_left"]["imageMode"]["calibrationTopic"] == "/cam_left/camera_info"
    mixed = copy.copy(sequence)
    lens = replace(sequence.cameras["cam_left"], distortion_model="equidistant")
    mixed.cameras = {**sequence.cameras, "cam_left": lens}
    made = layout(mixed)
    modes = {key: config["imageMode"] for key, config in panels(made, "Image").items()}
    assert modes["Image!cam_left"] == {"imageTopic": "/cam_left/image"}
    assert modes["Image!cam_right"]["calibrationTopic"] == "/cam_right/camera_info"
    assert modes["Image!cam_left_depth"]["imageTopic"] == "/cam_left/depth"
    assert "/cam_left/camera_info" not in json.dumps(made)


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
    assert {key.removeprefix("frame:") for key in scene["transforms"]} <= frames


def test_the_grid_lies_where_the_dive_begins(sequence, made):
    (scene,) = panels(made, "3D").values()
    assert scene["layers"]["grid"]["position"] == [0, 0, pytest.approx(sequence.truth().positions[0, 2], abs=0.01)]


def test_every_curve_is_a_number_of_a_message(sequence, made):
    paths = list(plotted(made))
    topics = {path.partition(".")[0] for path in paths}
    assert topics == {
        "/imu", "/truth/odometry", "/truth/pose", "/dvl/velocity", "/dvl/altitude", "/pressure", "/magnetometer",
        "/alt/range",
    }  # fmt: skip
    firsts = {topic: next(iter(read_messages(sequence.path, [topic]))) for topic in topics}
    for path in paths:
        topic, *fields = path.split(".")
        value = decode(firsts[topic].data, sequence.types[topic])
        for field in fields:
            value = getattr(value, field)
        assert isinstance(value, NUMBERS), path


def test_the_path_from_above_is_of_two_topics_with_the_same_stamps(sequence, made):
    """Lichtblick draws no curve whose x and y are of one topic, and pairs those of two one by one."""
    config = made["configById"]["Plot!from_above"]
    (path,) = config["paths"]
    x, y = (value.partition(".")[0] for value in (config["xAxisPath"]["value"], path["value"]))
    assert x != y
    assert path["showLine"]
    stamps = {
        topic: [
            stamp_of(decode(message.data, sequence.types[topic]).header)
            for message in read_messages(sequence.path, [topic])
        ]
        for topic in (x, y)
    }
    assert stamps[x] == stamps[y]


def test_the_magnetic_field_fills_its_plot(sequence, made):
    """Axes of their own accord would end at a thousandth of a tesla, and the field would be a line at 0."""
    config = made["configById"]["Plot!magnetometer_magnetic_field"]
    fields = [
        decode(message.data, sequence.types["/magnetometer"]).magnetic_field
        for message in read_messages(sequence.path, ["/magnetometer"])
    ]
    greatest = max(abs(getattr(field, part)) for field in fields for part in "xyz")
    assert greatest < config["maxYValue"] == -config["minYValue"] <= 10 * greatest


def test_no_legend_lies_over_the_curves(made):
    for config in panels(made, "Plot").values():
        assert not config["showLegend"] or config["legendDisplay"] == "left"


def test_every_panel_but_tabs_has_a_title_for_both_apps(made):
    for key, config in made["configById"].items():
        titles = [config.get(title) for title in TITLES]
        assert titles == [None, None] if key.startswith("Tab!") else titles[0] and titles[0] == titles[1]
    assert TITLES == ("foxglovePanelTitle", "lichtblickPanelTitle")


def test_titles_of_tabs_are_short_and_no_two_are_the_same(made):
    """The bar of tabs cuts off titles of more than some twelve letters."""
    tabs = {key: [tab["title"] for tab in config["tabs"]] for key, config in panels(made, "Tab").items()}
    assert tabs == {
        "Tab!layers": ["depth", "instance", "visibility"],
        "Tab!plots": ["imu", "truth", "dvl/velocity", "dvl/altitude", "pressure", "magnetometer", "alt"],
    }


def keys(config, above=""):
    """Keys of a panel's settings, those of settings within settings after a dot, and * for a name or a place."""
    for key, value in config.items():
        under = value if isinstance(value, list) and value and isinstance(value[0], dict) else None
        if above == "" and key in NAMED:
            under = value.values()
        if key == "layout":
            yield f"{above}layout"
        elif under is not None:
            for one in under:
                yield from keys(one, f"{above}{key}.*.")
        elif isinstance(value, dict):
            yield from keys(value, f"{above}{key}.")
        else:
            yield above + key


def test_the_apps_know_every_key(made):
    for key, config in made["configById"].items():
        assert set(keys(config)) - set(TITLES) <= KEYS[key.partition("!")[0]], key


def test_each_panel_stands_at_one_place_and_none_is_a_strip(made):
    there = list(leaves(made))
    tabs = panels(made, "Tab").keys()
    assert sorted([*(key for key, _, _ in there), *tabs]) == sorted(made["configById"])
    for key, width, height in there:
        assert width > 0.24, key
        assert height > (0.45 if key.startswith("Image!") else 0.24), key


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
    with pytest.raises(SequenceError, match=r"topics of a sequence file \(\.mcap\), /imu among them"):
        layout(oysterbench.open(folder))
