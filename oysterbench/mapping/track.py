"""An oyster of the map, with everything that images show of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.mapping.projection import Patch

KEPT = 200  # points kept for an oyster


class OysterTrack:
    """An oyster seen in one or more images.

    points: (N, 3) m, a sample of all that is seen of it; doubt: probability that it is part of another oyster, or that
    it contains another one
    """

    def __init__(self, first: Patch) -> None:
        self.patches = [first]
        self.points = first.points
        self.doubt = 0.0
        self._information = np.linalg.inv(first.covariance)
        self._vector = self._information @ first.centre
        self._centre = first.centre

    def add(self, patches: Sequence[Patch], points: Array) -> None:
        """Add views of the oyster, and the points (N, 3) m that they show."""
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
        """Centre (3,) m: information-weighted mean of the patches' centres; rays from different places meet there."""
        return self._centre

    @property
    def covariance(self) -> Array:
        """Covariance (3, 3) m^2 of the centre."""
        return np.linalg.inv(self._information)

    @property
    def area_m2(self) -> float:
        """Largest area that any image shows."""
        return max(patch.area_m2 for patch in self.patches)

    @property
    def frames(self) -> set[int]:
        """Images that show it."""
        return {patch.frame for patch in self.patches}

    @property
    def whole(self) -> bool:
        """Whether any image shows it uncut."""
        return any(not patch.cut for patch in self.patches)

    @property
    def state(self) -> str:
        """State that most pixels have: live, dead or, if none has one, unknown."""
        pixels: Counter[str] = Counter()
        for patch in self.patches:
            if patch.state != "unknown":
                pixels[patch.state] += patch.pixels
        return max(pixels, key=lambda state: (pixels[state], state)) if pixels else "unknown"

    @property
    def score(self) -> float:
        """Mean score over its images, weighted by pixels."""
        pixels = sum(patch.pixels for patch in self.patches)
        return sum(patch.score * patch.pixels for patch in self.patches) / pixels
