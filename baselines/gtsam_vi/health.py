"""How each pose was had: what counts as a loss, and when it is overcome."""

from __future__ import annotations

from oysterbench.methods import Health
from oysterbench_baselines.gtsam_vi.loops import LoopCloser


class HealthWatch:
    """Follows the frames. memory_s: for longer than which nothing in sight is a loss."""

    def __init__(self, memory_s: float) -> None:
        self._memory_ns = memory_s * 1e9
        self._seen_ns = 0  # when there was last enough in sight
        self._lost_at = 0  # the key frame after the last loss; 0 before there was one
        self._found = False  # whether a loop has bridged it

    def lose(self, keyframe: int) -> None:
        """The window was given up at a key frame."""
        self._lost_at, self._found = keyframe, False

    def look_for_ties(self, loops: LoopCloser) -> None:
        """Whether loops join what was seen since the loss to what was seen before."""
        self._found = self._lost_at > 0 and loops.ties(self._lost_at)

    def health(self, stamp_ns: int, keyframe: int, sees: bool) -> Health:
        """Of a frame after a key frame; sees: whether it sees enough of what is known to be held by it."""
        if not sees:
            return Health.COASTING
        if self._seen_ns and stamp_ns - self._seen_ns > self._memory_ns:
            self.lose(keyframe)
        self._seen_ns = stamp_ns
        return Health.RELOCALISED if self._found else Health.TRACKING
