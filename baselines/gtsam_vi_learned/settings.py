"""Settings: those of gtsam_vi, and how the network's output is used."""

from __future__ import annotations

from dataclasses import dataclass, field

from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings


@dataclass(frozen=True)
class LearnedSettings:
    """What maps and expected errors are used for."""

    maps: bool = False  # track in the maps; False: in the image, as gtsam_vi does, which is more exact so far
    error_power: float = 2.0  # of the expected error, by which a corner's score is divided
    max_error_px: float = 20.0  # expected; beyond, no track starts or continues: nowhere, as trained so far


@dataclass(frozen=True)
class GtsamViLearnedSettings(GtsamViSettings):
    """All settings, by part."""

    learned: LearnedSettings = field(default_factory=LearnedSettings)
