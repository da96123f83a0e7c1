"""Sensors on the vehicle of a split, in the words in which methods state what they use."""

from __future__ import annotations

from functools import cache

from oysterbench.recipe import load_split, split_names

SENSORS = {
    "imu": "imu",
    "dvl": "dvl",
    "sonar": "sonar",
    "pressure": "pressure",
    "magnetometer": "compass",
    "altimeter": "altimeter",
}
"""Block of a rig -> word for that sensor."""


@cache
def carried(split: str) -> tuple[str, ...]:
    """Sensors on board: the cameras, then the others in the order of `SENSORS`; empty for a split that is not shipped
    with oysterbench."""
    if split not in split_names():
        return ()
    rig = load_split(split).rig
    blocks = {sensor.block for sensor in rig.sensors}
    cameras = ("mono", "stereo")[: len(rig.camera)]
    return (*cameras, *(word for block, word in SENSORS.items() if block in blocks))


def lacks(split: str, track: str) -> str:
    """Note on a board whose vehicle lacks sensors that methods may use: they ran without. Empty where it has all, where
    that is not known, and for image tracks."""
    there = carried(split)
    lacking = [] if "stereo" in there else ["second camera"]
    lacking += [word for word in SENSORS.values() if word not in there]
    if track not in ("slam", "density") or not there or not lacking:
        return ""
    *others, last = (word.upper() if word in ("imu", "dvl") else word for word in lacking)
    none = f"{', '.join(others)} or {last}" if others else last
    return f"The vehicle of {split} has no {none}: a method that uses such a sensor ran without it."
