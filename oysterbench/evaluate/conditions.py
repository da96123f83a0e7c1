"""What a sequence may be like: numbers to plot errors against, and classes to group sequences by."""

from __future__ import annotations

from dataclasses import dataclass

STRATA = ("water", "light", "density", "motion")
"""The conditions that are classes; each sequence is in one class of each."""


@dataclass(frozen=True)
class Condition:
    """How a condition is written: a heading and a unit; empty for a class or a plain number."""

    heading: str
    unit: str = ""


CONDITIONS: dict[str, Condition] = {
    "water": Condition("Water"),
    "light": Condition("Light"),
    "density": Condition("Density"),
    "motion": Condition("Motion"),
    "water_type": Condition("Water type"),
    "path": Condition("Path"),
    "secchi_m": Condition("Secchi depth", "m"),
    "altitude_m": Condition("Altitude", "m"),
    "oysters_per_m2": Condition("Oysters", "per m\N{SUPERSCRIPT TWO}"),
    "speed_m_s": Condition("Speed", "m/s"),
    "depth_m": Condition("Depth", "m"),
    "snow_per_m3": Condition("Marine snow", "per m\N{SUPERSCRIPT THREE}"),
    "daylight": Condition("Daylight"),
    "wind_m_s": Condition("Wind", "m/s"),
    "wave_height_m": Condition("Wave height", "m"),
    "current_m_s": Condition("Current", "m/s"),
    "plant_cover": Condition("Plant cover"),
    "duration_s": Condition("Duration", "s"),
}
"""Conditions by their key in a record, classes first."""
