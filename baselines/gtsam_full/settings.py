"""Settings of the fully aided baseline: those of gtsam_vi, of the filter, and of what joins the two."""

from __future__ import annotations

from dataclasses import dataclass, field

from oysterbench_baselines.common.aiding import AidingSettings
from oysterbench_baselines.common.start import StartSettings
from oysterbench_baselines.gtsam_vi.settings import Settings as VisualInertialSettings


@dataclass(frozen=True)
class Settings(VisualInertialSettings):
    """start_tilt_deg, start_s, start_keyframes: with a DVL the window begins once the filter's roll and pitch are this
    certain (1 sigma), but not before so many seconds and key frames: one key frame has no landmarks."""

    start: StartSettings = field(default_factory=StartSettings)
    aiding: AidingSettings = field(default_factory=AidingSettings)
    start_tilt_deg: float = 1.0
    start_s: float = 1.5
    start_keyframes: int = 4
    aiding_huber: float = 3.0  # sigmas; beyond, a residual of a DVL or compass counts linearly
    compass_delay_s: float = 0.06  # a reading older than this does not count for a key frame
