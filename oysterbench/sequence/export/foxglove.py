"""A Foxglove layout that opens a sequence's file with cameras, sonars, path and plots arranged.

The file is what the app writes under "Export layout to file" and reads under "Import from file": panels by their ids,
`TYPE!NAME`, and a binary tree of their positions. Keys of the panels are those of Foxglove's SDK (foxglove.layouts).
Lichtblick reads the same, but ignores `fixedFrame` and `axisScalesMode`, and has its own key for titles.
"""

from __future__ import annotations

import json
from collections.abc import Sequence as Several
from pathlib import Path
from typing import Any

from oysterbench.core.errors import SequenceError
from oysterbench.core.ros import BASE, IMAGE, MAP, POINTS
from oysterbench.sensors.camera_messages import CAMERA_INFO, COLOUR, LAYERS
from oysterbench.sensors.panels import white_of
from oysterbench.sequence.export import mcap
from oysterbench.sequence.export.steps import Steps
from oysterbench.sequence.truth import TF, TRANSFORMS, TRUTH, TRUTH_POSE
from oysterbench.sequence.types import Sequence

LAYOUT = "foxglove-layout.json"

PANEL_SCHEMAS = {
    "Image": (COLOUR, IMAGE),
    "calibration": (CAMERA_INFO,),
    "3D": ("geometry_msgs/msg/PoseStamped", POINTS, CAMERA_INFO, TRANSFORMS),
}
"""Panel, or part of one -> message types in sequences that it can show; a plot takes all."""

TITLES = ("foxglovePanelTitle", "lichtblickPanelTitle")
"""Keys of a panel's title: Foxglove's, and Lichtblick's."""

KNOWN_LENSES = ("plumb_bob",)
"""Distortion models whose calibration a panel can use. With any other, the image panel shows no image at all; without
a calibration, it shows the image as it was taken."""

SHOWN_ENCODINGS = ("16UC1", "32FC1")
"""Encodings of layers that the image panel can show: it takes no images with two or three floating-point channels, and
may draw mono8 as grey from 0 to 255, whatever the scale: classes, from 0 to 11, are then black."""

GREATEST = {"depth": 8000, "visibility": 1, "transmittance": 1}
"""Layer -> value shown in the last colour; depth in mm. For instances, it depends on the sequence."""

PLOTS: dict[str, tuple[tuple[str, str, tuple[str, ...]], ...]] = {
    "sensor_msgs/msg/Imu": (
        ("angular rate, rad/s", "angular_velocity", ("x", "y", "z")),
        ("specific force, m/s²", "linear_acceleration", ("x", "y", "z")),
    ),
    "geometry_msgs/msg/TwistWithCovarianceStamped": (("velocity, m/s", "twist.twist.linear", ("x", "y", "z")),),
    "sensor_msgs/msg/FluidPressure": (("pressure, Pa", "fluid_pressure", ()),),
    "sensor_msgs/msg/Range": (("range, m", "range", ()),),
    "sensor_msgs/msg/MagneticField": (("magnetic field, T", "magnetic_field", ("x", "y", "z")),),
    "nav_msgs/msg/Odometry": (("velocity, m/s", "twist.twist.linear", ("x", "y", "z")),),
}
"""Message type -> plots of its topics: axis label with unit, field, and the parts of that field that share the plot."""

LIMITS = {"magnetic_field": 1e-4}
"""Field -> limit of its plot, from minus to plus, in its unit: by default, Lichtblick's axes end at a thousandth or
more, where the Earth's field, of up to 67 µT, is a flat line."""

COLOURS = ("#4e98e2", "#f5774d", "#2ecf9f")
"""Colours of x, y and z, as in the pages of `oysterbench view`."""

LEGEND_PX = 60
"""Width of a plot's legend, next to the curves: a floating one would cover them."""

Node = str | dict[str, Any]


def write(sequence: Sequence, folder: Path, truth: bool, steps: Steps) -> list[str]:
    """Write NAME.mcap, whole or cut as in the format mcap, and the layout for it."""
    notes = mcap.write(sequence, folder, truth, steps)
    text = layout_text(sequence if truth else sequence.for_method())
    (folder / LAYOUT).write_text(text, encoding="utf-8")
    return [*notes, f"in Foxglove: open {sequence.name}.mcap, then Layouts, Import from file, {LAYOUT}"]


def layout_text(sequence: Sequence) -> str:
    """The layout for a sequence as JSON text."""
    return json.dumps(layout(sequence), indent=2, ensure_ascii=False) + "\n"


def layout(sequence: Sequence) -> dict[str, Any]:
    """The layout for a sequence's own topics, as JSON values. Raises SequenceError where it is no MCAP file."""
    types = {topic: kind for topic, kind, count in sequence.contents() if count}
    if "/imu" not in types:
        raise SequenceError(
            f"{sequence.name}: a layout needs the topics of a sequence file (.mcap), /imu among them, and finds none"
        )
    panels: dict[str, Any] = {}
    cameras = [_image(panels, name, f"/{name}/image", _calibration(sequence, name)) for name in sequence.cameras]
    sonars = [_sonar(panels, sequence, name) for name in sequence.sonars if f"/{name}/image" in types]
    layers = _layers(panels, sequence, types)
    left = [*cameras, *([layers] if layers else []), *sonars]
    right = [_scene(panels, sequence, types), *_from_above(panels, types)]
    columns = [_pictures(left), _stacked("column", [_stacked("row", right), _plots(panels, types)])]
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _stacked("row", [column for column in columns if column]),
    }


def _image(panels: dict[str, Any], name: str, topic: str, calibration: str | None = None, **shown: Any) -> str:
    mode = {"imageTopic": topic, **({"calibrationTopic": calibration} if calibration else {}), **shown}
    return _panel(panels, f"Image!{name}", {"imageMode": mode}, topic)


def _calibration(sequence: Sequence, name: str) -> str | None:
    """Topic of a camera's calibration; None where the panels do not support its distortion model."""
    return f"/{name}/camera_info" if sequence.cameras[name].distortion_model in KNOWN_LENSES else None


def _sonar(panels: dict[str, Any], sequence: Sequence, name: str) -> str:
    """Image panel of a sonar: beams across, ranges down, as the panel draws no fan. Its scale suits the first ping."""
    first = next(sequence.sonar(name), None)
    white = 65535.0 if first is None else white_of(first.pixels)
    return _image(panels, name, f"/{name}/image", **_scale(white))


def _scale(greatest: float) -> dict[str, Any]:
    return {"colorMode": "colormap", "colorMap": "turbo", "minValue": 0, "maxValue": greatest}


def _layers(panels: dict[str, Any], sequence: Sequence, types: dict[str, str]) -> str | None:
    """Panel with a tab for each ground-truth layer; None without any."""
    shown = [layer for layer, encoding in LAYERS.items() if encoding in SHOWN_ENCODINGS]
    there = {name: [layer for layer in shown if f"/{name}/{layer}" in types] for name in sequence.cameras}
    several = len([layers for layers in there.values() if layers]) > 1
    tabs = []
    for name, layers in there.items():
        for layer in layers:
            topic, scale = f"/{name}/{layer}", _scale(_greatest(sequence, name, layer))
            panel = _image(panels, f"{name}_{layer}", topic, _calibration(sequence, name), **scale)
            tabs.append({"title": f"{layer} {name}" if several else layer, "layout": panel})
    return _panel(panels, "Tab!layers", {"activeTabIdx": 0, "tabs": tabs}) if tabs else None


def _greatest(sequence: Sequence, name: str, layer: str) -> float:
    """Value of a layer that is shown in the last colour.

    For instances, the number of the last oyster, or the greatest in the first image if that is greater: stones and
    shells come after the oysters, and can be most of what is seen.
    """
    if layer != "instance":
        return GREATEST[layer]
    first = next(sequence.layer(name, layer), None)
    return int(max([1, *sequence.oysters()["id"], *([] if first is None else [first.pixels.max()])]))


def _scene(panels: dict[str, Any], sequence: Sequence, types: dict[str, str]) -> str:
    """3D panel with frames from /tf and /tf_static, pose, clouds, and camera frustums, in `map` or, without ground
    truth, in the body."""
    true = TF in types
    calibrations = [_calibration(sequence, name) for name in sequence.cameras]
    topics: dict[str, Any] = {topic: {"visible": True, "distance": 0.5} for topic in calibrations if topic}
    if TRUTH_POSE in types:
        topics[TRUTH_POSE] = {"visible": True, "type": "arrow", "arrowScale": [0.6, 0.1, 0.1], "color": "#f5774dff"}
    for topic, kind in types.items():
        if kind == POINTS:
            topics[topic] = {"visible": True, "pointSize": 5, "colorMode": "colormap", "colorMap": "turbo",
                             "colorField": "z", "decayTime": 5 if true else 0}  # fmt: skip
    grid = {"visible": True, "layerId": "foxglove.Grid", "instanceId": "grid", "label": "metres", "size": 20,
            "divisions": 20, "lineWidth": 1, "color": "#80808066", "frameId": MAP if true else BASE,
            "position": [0, 0, _level(sequence) if true else 0]}  # fmt: skip
    return _panel(
        panels,
        "3D!scene",
        {
            "cameraState": {"distance": 5, "perspective": True, "phi": 50, "thetaOffset": 45, "fovy": 45,
                            "near": 0.05, "far": 5000, "target": [0, 0, 0], "targetOffset": [0, 0, 0],
                            "targetOrientation": [0, 0, 0, 1]},
            "followMode": "follow-position",
            "followTf": BASE,
            **({"fixedFrame": MAP} if true else {}),
            "scene": {"transforms": {"showLabel": False, "lineWidth": 1, "lineColor": "#80808080"}},
            "transforms": {f"frame:{BASE}": {"visible": True}},
            "layers": {"grid": grid},
            "topics": topics,
        },
        "vehicle and frames" if true else "frames of the vehicle",
    )  # fmt: skip


def _level(sequence: Sequence) -> float:
    """Height in map at which the dive starts, m: the origin of map is at the surface, metres above the vehicle."""
    return round(float(sequence.truth().positions[0, 2]), 2)


def _from_above(panels: dict[str, Any], types: dict[str, str]) -> list[str]:
    """Plot of the whole path from above, y over x.

    x and y are from two topics with the same stamps, paired one by one: Lichtblick 1.28 draws no curve with both from
    one topic.
    """
    if TRUTH not in types or TRUTH_POSE not in types:
        return []
    x, y = f"{TRUTH_POSE}.pose.position.x", f"{TRUTH}.pose.pose.position.y"
    path = {"value": y, "enabled": True, "label": "true path", "color": COLOURS[0], "timestampMethod": "headerStamp",
            "showLine": True}  # fmt: skip
    config = {"paths": [path], "xAxisVal": "custom", "xAxisPath": {"value": x, "enabled": True},
              "axisScalesMode": "lockedScales", "xAxisLabel": "east, m", "yAxisLabel": "north, m",
              "showLegend": False}  # fmt: skip
    return [_panel(panels, "Plot!from_above", config, "path from above")]


def _plots(panels: dict[str, Any], types: dict[str, str]) -> Node | None:
    """Panel of curves over time, a tab for each topic that has some; those of a topic are stacked."""
    topics = [topic for topic, kind in types.items() if kind in PLOTS]
    sensors = [topic.split("/")[1] for topic in topics]
    tabs = []
    for topic, sensor in zip(topics, sensors, strict=True):
        made = [_plot(panels, topic, *plot) for plot in PLOTS[types[topic]]]
        title = sensor if sensors.count(sensor) == 1 else topic.strip("/")
        tabs.append({"title": title, "layout": _stacked("column", made)})
    return _panel(panels, "Tab!plots", {"activeTabIdx": 0, "tabs": tabs}) if tabs else None


def _plot(panels: dict[str, Any], topic: str, unit: str, field: str, parts: tuple[str, ...]) -> str:
    paths = [
        {"value": ".".join([topic, field, *([part] if part else [])]), "enabled": True, "label": part or field,
         "color": colour, "timestampMethod": "headerStamp", "showLine": True}
        for part, colour in zip(parts or ("",), COLOURS, strict=False)
    ]  # fmt: skip
    config = {"paths": paths, "xAxisVal": "timestamp", "isSynced": True, "yAxisLabel": unit, "showLegend": bool(parts),
              "legendDisplay": "left", "sidebarDimension": LEGEND_PX}  # fmt: skip
    if field in LIMITS:
        config |= {"minYValue": -LIMITS[field], "maxYValue": LIMITS[field]}
    key = f"Plot!{topic.strip('/').replace('/', '_')}_{field.replace('.', '_')}"
    return _panel(panels, key, config, f"{topic} {unit}")


def _panel(panels: dict[str, Any], key: str, config: dict[str, Any], title: str = "") -> str:
    panels[key] = config | (dict.fromkeys(TITLES, title) if title else {})
    return key


def _pictures(nodes: Several[Node]) -> Node | None:
    """Arrange up to two image panels in a column, and more in rows of two, as one column would leave each a strip."""
    if len(nodes) < 3:
        return _stacked("column", nodes)
    return _stacked("column", [_stacked("row", nodes[i : i + 2]) for i in range(0, len(nodes), 2)])


def _stacked(direction: str, nodes: Several[Node | None]) -> Node | None:
    """Arrange nodes side by side ("row") or one below the other ("column"), all of equal size, as a binary tree."""
    there = [node for node in nodes if node is not None]
    if len(there) < 2:
        return there[0] if there else None
    share = 100.0 / len(there)
    rest = _stacked(direction, there[1:])
    return {"direction": direction, "first": there[0], "second": rest, "splitPercentage": round(share, 3)}
