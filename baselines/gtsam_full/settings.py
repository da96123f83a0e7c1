"""Settings of the fully aided baseline: those of gtsam_vi, of the aiding sensors, and of what joins the two."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

from oysterbench.sequence.types import Sequence
from oysterbench_baselines.common.aiding import SonarAidingSettings, sensors_of
from oysterbench_baselines.common.alignment import StartSettings
from oysterbench_baselines.gtsam_full.ranges import RangeSettings
from oysterbench_baselines.gtsam_vi.initialisation import FilterStartSettings
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings, renamed_options


@dataclass(frozen=True)
class BesideDvlSettings:
    """How corners count beside a DVL. Without one they alone give the displacement, and count as in gtsam_vi."""

    pixel_sigma_px: float = 3.0  # corners under moving light err together, so each counts for less
    huber: float = 0.43  # sigmas, 1.3 px: a track that slides off its point does so by less than 3 px at a time
    max_innovation_px: float = 4.0  # DVL and IMU predict better than the IMU alone
    correlation: float = 1.0  # it is included in those 3 px


@dataclass(frozen=True)
class GtsamFullSettings(GtsamViSettings):
    """All settings, by part; those of `beside_dvl` take the place of `noise` and `landmarks` where there is a DVL."""

    renamed: ClassVar[Mapping[str, str]] = {
        **GtsamViSettings.renamed,
        **renamed_options(
            "aiding.dvl = aiding_huber:huber "
            "aiding.magnetometer = compass_delay_s:max_delay_s compass_keyframes:keyframes "
            "filter_start = start_tilt_deg:tilt_deg start_s:min_s start_keyframes:min_keyframes ranges = ranges:enabled"
        ),
    }

    start: StartSettings = field(default_factory=StartSettings)
    # Before the filter knows how late the DVL is, its pings would all err alike, and the window would keep that.
    filter_start: FilterStartSettings = field(default_factory=lambda: FilterStartSettings(min_s=4.0))
    aiding: SonarAidingSettings = field(default_factory=SonarAidingSettings)
    ranges: RangeSettings = field(default_factory=RangeSettings)
    beside_dvl: BesideDvlSettings = field(default_factory=BesideDvlSettings)
    dvl: bool = True  # whether it is used where there is one; likewise depth and compass
    depth: bool = True
    compass: bool = True
    sonar: bool = True
    pictures: bool = True  # False leaves the camera out, as in water where it sees nothing

    def sensors(self, sequence: Sequence) -> list[str]:
        """The aiding sensors of a rig that are to be used, as `Sequence.stream` names them."""
        used = {"dvl": self.dvl, "pressure": self.depth, "magnetometer": self.compass}
        return [kind for kind in sensors_of(sequence) if used[kind]]

    def for_rig(self, sequence: Sequence) -> GtsamFullSettings:
        """Settings with those of `beside_dvl` put in place, where the rig has a DVL that is to be used."""
        if "dvl" not in self.sensors(sequence):
            return self
        b = self.beside_dvl
        noise = replace(self.noise, pixel_sigma_px=b.pixel_sigma_px, huber=b.huber, correlation=b.correlation)
        return replace(self, noise=noise, landmarks=replace(self.landmarks, max_innovation_px=b.max_innovation_px))
