"""Conditions of a sequence: numbers to plot errors against, and classes to group sequences by."""

from __future__ import annotations

from dataclasses import dataclass

STRATA = ("difficulty", "disturbance", "water", "light", "density", "motion")
"""The conditions that are classes; a sequence belongs to one class of each condition that its split states."""


@dataclass(frozen=True)
class Condition:
    """How a condition is displayed: its name and unit; the unit is empty for a class or a plain number."""

    name: str
    unit: str = ""


CONDITIONS: dict[str, Condition] = {
    "difficulty": Condition("difficulty", "of 5"),
    "disturbance": Condition("disturbance"),
    "strength": Condition("strength of disturbance", "of 3"),
    "calibration": Condition("calibration"),
    "water": Condition("water"),
    "light": Condition("light"),
    "density": Condition("density"),
    "motion": Condition("motion"),
    "water_type": Condition("water type"),
    "path": Condition("path"),
    "secchi_m": Condition("Secchi depth", "m"),
    "altitude_m": Condition("altitude", "m"),
    "oysters_per_m2": Condition("oyster density", "per m\N{SUPERSCRIPT TWO}"),
    "speed_m_s": Condition("speed", "m/s"),
    "depth_m": Condition("depth", "m"),
    "snow_per_m3": Condition("marine snow", "per m\N{SUPERSCRIPT THREE}"),
    "daylight": Condition("daylight"),
    "wind_m_s": Condition("wind", "m/s"),
    "wave_height_m": Condition("wave height", "m"),
    "current_m_s": Condition("current", "m/s"),
    "plant_cover": Condition("plant cover"),
    "layer_factor": Condition("turbid layer"),
    "silt_per_m": Condition("silt in plumes", "1/m"),
    "duration_s": Condition("duration", "s"),
}
"""Conditions by their key in a record, classes first."""
