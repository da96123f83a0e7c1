"""Health of each pose: what counts as a loss of tracking, and when it is overcome."""

from __future__ import annotations

from oysterbench.methods import Health
from oysterbench_baselines.gtsam_vi.loops import LoopCloser


class HealthWatch:
    """Health of the frames, one after another. memory_s: seeing too little for longer than this is a loss."""

    def __init__(self, memory_s: float) -> None:
        self._memory_ns = memory_s * 1e9
        self._seen_ns = 0  # when enough was last in sight
        self._lost_at = 0  # the keyframe after the last loss; 0 before there was one
        self._found = False  # whether a loop has bridged it

    def lose(self, keyframe: int) -> None:
        """Note a loss at a keyframe, as when the window is given up."""
        self._lost_at, self._found = keyframe, False

    def look_for_ties(self, loops: LoopCloser) -> None:
        """Check whether loops connect what was seen since the loss to what was seen before."""
        self._found = self._lost_at > 0 and loops.ties(self._lost_at)

    def health(self, stamp_ns: int, keyframe: int, sees: bool) -> Health:
        """Health of a frame after a keyframe; sees: whether it sees enough known landmarks to constrain its pose."""
        if not sees:
            return Health.COASTING
        if self._seen_ns and stamp_ns - self._seen_ns > self._memory_ns:
            self.lose(keyframe)
        self._seen_ns = stamp_ns
        return Health.RELOCALISED if self._found else Health.TRACKING
