"""An oyster of the map: what all pictures show of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.mapping.projection import Patch

KEPT = 200  # points of an oyster


class OysterTrack:
    """An oyster, seen in one picture or more.

    points: (N, 3) m, some of all that is seen of it; doubt: chance that it is the part of another one, or that another
    one is in it
    """

    def __init__(self, first: Patch) -> None:
        self.patches = [first]
        self.points = first.points
        self.doubt = 0.0
        self._information = np.linalg.inv(first.covariance)
        self._vector = self._information @ first.centre
        self._centre = first.centre

    def add(self, patches: Sequence[Patch], points: Array) -> None:
        """More views, and what they see."""
        self.patches += patches
        self.points = np.concatenate([self.points, points])
        if len(self.points) > KEPT:
            self.points = self.points[np.linspace(0, len(self.points) - 1, KEPT).astype(int)]
        for patch in patches:
            information = np.linalg.inv(patch.covariance)
            self._information = self._information + information
            self._vector = self._vector + information @ patch.centre
        self._centre = np.linalg.solve(self._information, self._vector)

    @property
    def centre(self) -> Array:
        """(3,) m: mean of the middles, weighed by their information; rays from different places meet there."""
        return self._centre

    @property
    def covariance(self) -> Array:
        """(3, 3) m^2 of the centre."""
        return np.linalg.inv(self._information)

    @property
    def area_m2(self) -> float:
        """The greatest that a picture shows."""
        return max(patch.area_m2 for patch in self.patches)

    @property
    def frames(self) -> set[int]:
        """Pictures that show it."""
        return {patch.frame for patch in self.patches}

    @property
    def whole(self) -> bool:
        """Whether some picture shows it uncut."""
        return any(not patch.cut for patch in self.patches)

    @property
    def state(self) -> str:
        """What most pixels say: live, dead or unknown."""
        pixels: Counter[str] = Counter()
        for patch in self.patches:
            if patch.state != "unknown":
                pixels[patch.state] += patch.pixels
        return max(pixels, key=lambda state: (pixels[state], state)) if pixels else "unknown"

    @property
    def score(self) -> float:
        """Mean over its pictures, weighed by pixels."""
        pixels = sum(patch.pixels for patch in self.patches)
        return sum(patch.score * patch.pixels for patch in self.patches) / pixels
