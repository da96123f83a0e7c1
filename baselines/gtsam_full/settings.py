"""Settings of the fully aided baseline: those of gtsam_vi, of the filter, and of what joins the two."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace

from oysterbench.sequence.types import Sequence
from oysterbench_baselines.common.aiding import AidingSettings, sensors_of
from oysterbench_baselines.common.start import StartSettings
from oysterbench_baselines.gtsam_vi.settings import Settings as VisualInertialSettings


@dataclass(frozen=True)
class EchoSettings:
    """How ranges to the bottom count. The mounts' calibrations and the samples say nothing of noise."""

    sigma: float = 0.02  # m, 1 sigma of a range
    share: float = 0.01  # and of its length: speed of sound and beam patterns
    offset_sigma: float = 0.03  # m, of what echoes and corners differ by in the mean: an oyster stands out by as much
    radius: float = 0.25  # m, about the point met, in which landmarks are its ground; a wide beam has its footprint
    fewest: int = 6  # landmarks: three make a plane, as many again say how rough it is
    most: int = 12  # the nearest: more cost time, and say less of the point
    width: float = 0.03  # m, rms across the longest spread of the landmarks: less is a line
    steepest: float = 0.5  # cosine of the incidence
    delay_s: float = 0.15  # a range older than this does not count for a key frame
    silence_s: float = 1.0  # without a DVL's velocity, after which ranges count: it knows a metre ten times better


@dataclass(frozen=True)
class BesideDvl:
    """How corners count beside a DVL. Without one they are all that tells the way, and count as in gtsam_vi."""

    pixel_sigma_px: float = 3.0  # corners under moving light err together, and as one they count for less
    huber: float = 0.43  # sigmas, 1.3 px: a track that slides off its point does so by less than 3 px at a time
    max_slide_px: float = 4.0  # DVL and inertial unit predict better than the inertial unit alone
    alike: float = 1.0  # which is in those 3 px


@dataclass(frozen=True)
class Settings(VisualInertialSettings):
    """start_tilt_deg, start_s, start_keyframes: with a DVL the window begins once the filter's roll and pitch are this
    certain (1 sigma), but not before so many seconds and key frames: one key frame has no landmarks."""

    start: StartSettings = field(default_factory=StartSettings)
    aiding: AidingSettings = field(default_factory=AidingSettings)
    start_tilt_deg: float = 1.0
    start_s: float = 1.5
    start_keyframes: int = 4
    beside_dvl: BesideDvl = field(default_factory=BesideDvl)
    aiding_huber: float = 3.0  # sigmas; beyond, a residual of a DVL or compass counts linearly
    dvl: bool = True  # whether it is used where there is one; likewise depth and compass
    depth: bool = True
    compass: bool = True
    ranges: bool = True  # whether altimeters and the ranges of a DVL's beams are used where it gives no velocity
    echo: EchoSettings = field(default_factory=EchoSettings)
    compass_delay_s: float = 0.06  # a reading older than this does not count for a key frame
    compass_keyframes: int = 1  # from one reading that counts to the next; 3 saves an eighth of the time, and heading

    def sensors(self, sequence: Sequence) -> list[str]:
        """The aiding sensors of a rig that are to be used, as `Sequence.stream` names them."""
        used = {"dvl": self.dvl, "pressure": self.depth, "magnetometer": self.compass}
        return [kind for kind in sensors_of(sequence) if used[kind]]

    def for_rig(self, sequence: Sequence) -> Settings:
        """With `beside_dvl` in the place of what it names, where the rig has a DVL that is to be used."""
        return replace(self, **asdict(self.beside_dvl)) if "dvl" in self.sensors(sequence) else self
