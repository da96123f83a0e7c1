"""Names in a sequence file: topics, their ROS 2 types, and the frames of the rig."""

from __future__ import annotations

from collections.abc import Iterable

from oysterbench.recipe import RigRecipe

MAP, BASE = "map", "base_link"
IMU_FRAME, DVL_FRAME, PRESSURE_FRAME, MAGNETOMETER_FRAME = "imu_link", "dvl_link", "pressure_link", "magnetometer_link"

TF_STATIC, TF = "/tf_static", "/tf"
IMU, PRESSURE, MAGNETOMETER = "/imu", "/pressure", "/magnetometer"
DVL_VELOCITY, DVL_BEAMS, DVL_ALTITUDE = "/dvl/velocity", "/dvl/beams", "/dvl/altitude"
TRUTH, TRUTH_POSE = "/truth/odometry", "/truth/pose"

COLOUR = "sensor_msgs/msg/CompressedImage"
LAYER = "sensor_msgs/msg/Image"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
RANGE = "sensor_msgs/msg/Range"
ECHOES = "sensor_msgs/msg/Image"
CLOUD = "sensor_msgs/msg/PointCloud2"
HEAD = "sensor_msgs/msg/JointState"

TYPES = {
    TF_STATIC: "tf2_msgs/msg/TFMessage",
    IMU: "sensor_msgs/msg/Imu",
    TRUTH: "nav_msgs/msg/Odometry",
}
"""What every sequence has: the rig's frames, the inertial unit, and the truth."""

POSE_TYPES = {
    TRUTH_POSE: "geometry_msgs/msg/PoseStamped",
    TF: "tf2_msgs/msg/TFMessage",
}
"""The truth in two forms more, for viewers and for tools that want poses."""

DVL_TYPES = {
    DVL_VELOCITY: "geometry_msgs/msg/TwistWithCovarianceStamped",
    DVL_BEAMS: CLOUD,
    DVL_ALTITUDE: RANGE,
}
PRESSURE_TYPES = {PRESSURE: "sensor_msgs/msg/FluidPressure"}
MAGNETOMETER_TYPES = {MAGNETOMETER: "sensor_msgs/msg/MagneticField"}

TRUTH_TOPICS = (TRUTH, TRUTH_POSE, TF)
"""Topics that tell where the vehicle truly is."""

LAYERS = {
    "depth": "16UC1",
    "class": "mono8",
    "instance": "16UC1",
    "normals": "32FC3",
    "clean": "32FC3",
    "direct": "32FC3",
    "forward_scatter": "32FC3",
    "backscatter": "32FC3",
    "snow": "32FC3",
    "visibility": "32FC1",
}
"""Layers of a camera and their encodings. Depth in mm along the optical axis, 0 = none (REP 118)."""

PIXELS = {"mono8": ("u1", 1), "16UC1": ("<u2", 1), "32FC1": ("<f4", 1), "32FC3": ("<f4", 3)}
"""Encodings: type of a number, and numbers in a pixel."""


def optical_frame(camera: str) -> str:
    """Frame of a camera's measurements: z forward, x right, y down (REP 103)."""
    return f"{camera}_optical_frame"


def link(sensor: str) -> str:
    """Frame of a sonar or altimeter: x along its axis, y left, z up."""
    return f"{sensor}_link"


def camera_topics(camera: str, layers: Iterable[str] = tuple(LAYERS)) -> dict[str, str]:
    """Topic and type of everything that a camera sends: `image`, `camera_info` and the layers."""
    topics = {f"/{camera}/image": COLOUR, f"/{camera}/camera_info": CAMERA_INFO}
    return topics | {f"/{camera}/{layer}": LAYER for layer in layers}


def sonar_topics(sonar: str, cloud: bool = True) -> dict[str, str]:
    """Topic and type of an imaging sonar: its fan images, and the cloud of its returns if it sends one."""
    return {f"/{sonar}/image": ECHOES} | ({f"/{sonar}/cloud": CLOUD} if cloud else {})


def scanner_topics(scanner: str) -> dict[str, str]:
    """Topic and type of a scanning sonar: its pings, and the angle of its head at each."""
    return {f"/{scanner}/ping": ECHOES, f"/{scanner}/head": HEAD}


def altimeter_topics(altimeter: str) -> dict[str, str]:
    """Topic and type of an altimeter."""
    return {f"/{altimeter}/range": RANGE}


def rig_topics(rig: RigRecipe) -> dict[str, str]:
    """Topic -> type of everything that a rig sends, truth included, in the order of the file: the small ones first.

    Each topic has chunks of its own (`SequenceWriter.section` after each), so that reading one touches no other.
    """
    topics = TYPES | POSE_TYPES
    if rig.dvl is not None:
        topics |= DVL_TYPES
    if rig.pressure is not None:
        topics |= PRESSURE_TYPES
    if rig.magnetometer is not None:
        topics |= MAGNETOMETER_TYPES
    for altimeter in rig.altimeter:
        topics |= altimeter_topics(altimeter.name)
    for scanner in rig.scanner:
        topics |= scanner_topics(scanner.name)
    for camera in rig.camera:
        topics |= camera_topics(camera.name, camera.sent_layers)
    for sonar in rig.sonar:
        topics |= sonar_topics(sonar.name, sonar.cloud)
    return topics


def rig_frames(rig: RigRecipe) -> dict[str, tuple[str, ...]]:
    """Frame -> the keys that lead to its entry in calibration.json, for `/tf_static`."""
    frames: dict[str, tuple[str, ...]] = {IMU_FRAME: ("imu",)}
    if rig.dvl is not None:
        frames[DVL_FRAME] = ("dvl",)
    if rig.pressure is not None:
        frames[PRESSURE_FRAME] = ("pressure",)
    if rig.magnetometer is not None:
        frames[MAGNETOMETER_FRAME] = ("magnetometer",)
    frames |= {optical_frame(camera.name): ("cameras", camera.name) for camera in rig.camera}
    for kind, sensors in (("sonars", rig.sonar), ("scanners", rig.scanner), ("altimeters", rig.altimeter)):
        frames |= {link(sensor.name): (kind, sensor.name) for sensor in sensors}
    return frames
