"""What the recipes of all sensors have in common. Each kind's own keys are in its file in `oysterbench.sensors`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from oysterbench.core.errors import RecipeError
from oysterbench.recipe.keys import number


@dataclass(frozen=True, kw_only=True)
class SensorRecipe:
    """What every sensor has: a rate, a position on the vehicle, a clock, and losses.

    block: its table in a rig's file, `[block]` where a rig has at most one (`single`), else `[[block]]`.
    """

    block: ClassVar[str] = ""
    single: ClassVar[bool] = True

    rate_hz: float = number(0.01, 4000)  # messages per second
    position_m: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0))  # of the sensor in base_link
    clock_offset_ms: float = number(-1000, 1000, 0.0)  # offset of its timestamps; positive: late
    clock_jitter_ms: float = number(0, 10, 0.0)
    """1 sigma of a timestamp: 1 to 5 over USB; sensors of the same kind share a trigger."""
    dropout: float = number(0, 0.99, 0.0)  # share of messages that are lost
    dropout_burst: float = number(1, 1000, 1.0)  # mean number of messages lost in a row

    def check(self, where: str) -> None:
        """Check what no single key can express. Raises RecipeError, which starts with `where`.

        A share of losses requires bursts of a minimum length, as at least one message arrives between two of them; and
        sensors of echoes need a range interval that is not empty.
        """
        shortest = self.dropout / (1 - self.dropout)
        if self.dropout_burst < shortest:
            raise RecipeError(
                f"{where}: key '{self.block}.dropout_burst': expected at least {shortest:.3g} for dropout = "
                f"{self.dropout:g}, got {self.dropout_burst:g}"
            )
        least, greatest = getattr(self, "min_range_m", 0.0), getattr(self, "max_range_m", float("inf"))
        if least >= greatest:
            raise RecipeError(
                f"{where}: key '{self.block}.max_range_m': expected more than min_range_m = {least:g}, got {greatest:g}"
            )


@dataclass(frozen=True, kw_only=True)
class NamedSensorRecipe(SensorRecipe):
    """A sensor of which a rig may have several; topics start with its name. Pitch is positive below the horizon."""

    single: ClassVar[bool] = False

    name: str  # unique among the sensors of its kind
    pitch_deg: float = number(-90, 90, 0.0)  # of its axis, positive below the horizon
    yaw_deg: float = number(-180, 180, 0.0)  # of its axis from the bow, positive to port


@dataclass(frozen=True, kw_only=True)
class AcousticRecipe(NamedSensorRecipe):
    """What all acoustic ranging sensors have in common."""

    assumed_sound_speed_m_s: float | None = number(1300, 1700, None)
    """Speed of sound that ranges are computed with; default: the true one."""


@dataclass(frozen=True, kw_only=True)
class BinnedSonarRecipe(AcousticRecipe):
    """What sonars that record echo strength per range bin have in common."""

    frequency_khz: float = number(50, 3000, 750.0)  # of the carrier
    bins: int = number(16, 4096, 500)  # range bins
    min_range_m: float = number(0.05, 20, 0.1)  # range of the first bin
    max_range_m: float = number(0.5, 200, 10.0)  # range of the last bin
    bandwidth_khz: float = number(1, 1000, 200.0)  # bandwidth B: resolves c / 2B in range
    looks: float = number(0.5, 100, 1.0)
    """Number of looks: speckle intensity follows a Gamma distribution with this shape; 1: fully developed speckle."""
    noise_db: float = number(-200, 0, -105.0)
    """Noise relative to the echo of a perfect scatterer that fills a beam at 1 m."""
    tvg: bool = field(default=True)  # time-varying gain: compensates spreading and absorption
    volume_db: float | None = number(-120, -30, None)
    """Reverberation of the water: its volume backscattering strength, dB re 1/m; -90 in clear water, -70 to -50 in
    coastal water with plankton, bubbles or silt at hundreds of kHz (Urick 1983, ch. 8); None: none."""
    interference: float = number(0, 1, 0.0)  # share of pings hit by a pulse of another device
    interference_db: float = number(-120, 0, -60.0)
    """Level of that pulse relative to the echo of a perfect scatterer at 1 m."""
    interference_ms: float = number(0.05, 200, 10.0)
    """Length of that pulse: USBL and modems 5 to 20 ms, other sonars 0.05 to 1 ms."""
    interference_bearing_deg: float | None = number(-360, 360, None)  # direction of that device in map; default: drawn
