"""The true calibration of a camera, which knows when each of its images was taken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from oysterbench.core.ros import EPOCH_NS
from oysterbench.sequence.types import CameraCalibration


@dataclass(frozen=True)
class TrueCamera(CameraCalibration):
    """A camera whose frames may repeat an earlier image, and whose stamps may have jitter.

    shown_ns: stamp of a frame -> stamp of the frame whose image it shows, for frames that repeat one
    even: whether frames are taken at rate_hz from the epoch on, so that what stamps deviate from that is jitter
    """

    shown_ns: Mapping[int, int] = field(default_factory=dict)
    even: bool = False

    def taken_ns(self, stamp_ns: int) -> int:
        """Time at which the image that the frame with this stamp shows was truly taken, ns."""
        taken_ns = super().taken_ns(self.shown_ns.get(stamp_ns, stamp_ns))
        if not self.even:
            return taken_ns
        period_ns = 1e9 / self.rate_hz
        return EPOCH_NS + round(round((taken_ns - EPOCH_NS) / period_ns) * period_ns)
