"""Association of the oysters in different images, by their position on the ground and their shells' footprints.

Image by image, after alignment (`mapping.pose_graph`), oysters are assigned to the known ones, each to at most one, at
minimum total cost (Kuhn 1955). If positions are certain to a centimetre, the cost of a pair is the share of their
shells that does not overlap; otherwise it is the squared Mahalanobis distance of their centres, whose covariances are
elongated along the rays, and of their sizes. In that case, the common error of an image from its pose and depth is
estimated in a first assignment and removed before a second. Finally, parts of one shell that were never seen side by
side are joined: something hid the middle of the shell and so made two of it. Two oysters that one image shows
separately are never merged.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from oysterbench.core.geometry import Array
from oysterbench.mapping.overlap import overlaps, own_overlaps
from oysterbench.mapping.projection import Patch
from oysterbench.mapping.settings import MapSettings
from oysterbench.mapping.track import OysterTrack

FORBIDDEN = 1e6
FAR_COST = 0.3  # of two centres that are reach_m apart, against 1 for an overlap: it decides between equal overlaps
ROUNDS = 5  # of joining parts, in each of which a part is joined to at most one other
SHIFT_FROM = 5  # minimum number of pairs to remove the common error of an image
NEARLY_ALL = 0.9  # share of the images


class OysterTracks:
    """The oysters of a map, updated image by image."""

    def __init__(self, settings: MapSettings) -> None:
        self.settings = settings
        self.tracks: list[OysterTrack] = []
        self._sure: list[bool] = []

    @property
    def exact(self) -> bool:
        """Whether positions in nearly all images are certain enough to tell shells apart by their overlap."""
        return not self._sure or float(np.mean(self._sure)) >= NEARLY_ALL

    def add(self, found: Sequence[Patch]) -> None:
        """Add the oysters of one more image."""
        if not found:
            return
        known = self._near(found)
        exact = float(np.mean([patch.sigma_m for patch in found])) <= self.settings.exact_m
        self._sure.append(exact)
        pairs = self._assign(found, known, exact)
        if not exact and len(pairs) >= SHIFT_FROM:
            shift = np.median([known[j].centre - found[i].centre for i, j in pairs], axis=0)
            found = [patch.moved(shift) for patch in found]
            pairs = self._assign(found, known, exact)
        for i, j in pairs:
            known[j].add([found[i]], found[i].points)
        taken = {i for i, _ in pairs}
        self.tracks += [OysterTrack(patch) for i, patch in enumerate(found) if i not in taken]

    def _near(self, found: Sequence[Patch]) -> list[OysterTrack]:
        """Known oysters that the image may show."""
        if not self.tracks:
            return []
        tree = cKDTree(np.array([patch.centre for patch in found]))
        centres = np.array([track.centre for track in self.tracks])
        near = np.isfinite(np.asarray(tree.query(centres, distance_upper_bound=self.settings.reach_m)[0]))
        return [track for track, is_near in zip(self.tracks, near, strict=True) if is_near]

    def _assign(self, found: Sequence[Patch], known: Sequence[OysterTrack], exact: bool) -> list[tuple[int, int]]:
        """Pairs of indices (found, known) that are the same oyster."""
        from scipy.optimize import linear_sum_assignment  # a third of a second, wasted if nothing is mapped

        if not known:
            return []
        cost = self._overlap_cost(found, known) if exact else self._distance_cost(found, known)
        rows, columns = linear_sum_assignment(cost)
        return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if cost[i, j] < FORBIDDEN]

    def _overlap_cost(self, found: Sequence[Patch], known: Sequence[OysterTrack]) -> Array:
        settings = self.settings
        overlap = overlaps(found, known, settings)
        between = np.array([patch.centre for patch in found])[:, None] - np.array([track.centre for track in known])
        apart = np.linalg.norm(between, axis=2)
        cost = 1.0 - overlap + FAR_COST * apart / settings.reach_m
        return np.where((overlap < settings.least_overlap) | (apart > settings.reach_m), FORBIDDEN, cost)

    def _distance_cost(self, found: Sequence[Patch], known: Sequence[OysterTrack]) -> Array:
        squared = distances(found, known, self.settings)
        return np.where(squared > self.settings.gate, FORBIDDEN, squared)

    def joined(self) -> list[OysterTrack]:
        """Return the oysters after joining parts of one shell, the most certain pair first.

        Doubt remains both where a joined pair might be two and where a separate pair might be one: 1/2 at the decision
        threshold.
        """
        apart = self._apart()
        for _ in range(ROUNDS):
            pairs = sorted((doubt, i, j) for (i, j), doubt in apart.items() if doubt <= 0.5)
            if not pairs:
                break
            gone: set[int] = set()
            changed: set[int] = set()
            for doubt, i, j in pairs:
                if not {i, j} & (gone | changed):
                    self.tracks[i].add(self.tracks[j].patches, self.tracks[j].points)
                    self.tracks[i].doubt = max(self.tracks[i].doubt, doubt)
                    gone.add(j)
                    changed.add(i)
            self.tracks = [track for k, track in enumerate(self.tracks) if k not in gone]
            apart = self._apart()
        for (_, j), doubt in apart.items():
            self.tracks[j].doubt = max(self.tracks[j].doubt, 1.0 - doubt)
        return self.tracks

    def _apart(self) -> dict[tuple[int, int], float]:
        """Probability that they are two oysters, for each pair that overlaps or is near and that no image shows side by
        side.

        It falls with the overlap, from 1 without any through 1/2 at `join_overlap` to 0 at full overlap, or grows with
        the squared distance, through 1/2 at `join_gate` to 1 at twice that.
        """
        settings = self.settings
        if len(self.tracks) < 2:
            return {}
        frames = [track.frames for track in self.tracks]
        if self.exact:
            found = own_overlaps(self.tracks, settings)
            least = settings.join_overlap
            chances = {
                pair: 1.0 - 0.5 * share / least if share < least else 0.5 * (1.0 - share) / (1.0 - least)
                for pair, share in found.items()
            }
        else:
            chances = {
                pair: 0.5 * d / settings.join_gate
                for pair, d in own_distances(self.tracks, settings).items()
                if d < 2.0 * settings.join_gate
            }
        return {(i, j): chance for (i, j), chance in chances.items() if not frames[i] & frames[j]}


def distances(found: Sequence[Patch], known: Sequence[OysterTrack], settings: MapSettings) -> Array:
    """Squared Mahalanobis distances (N, M) of centres and sizes between N oysters of an image and M known ones."""
    between = np.array([track.centre for track in known])[None] - np.array([patch.centre for patch in found])[:, None]
    covariances = np.array([patch.covariance for patch in found])[:, None] + np.array([t.covariance for t in known])
    sizes = np.log([patch.area_m2 for patch in found])[:, None] - np.log([track.area_m2 for track in known])
    return _squared(between, covariances, sizes, settings)


def own_distances(tracks: Sequence[OysterTrack], settings: MapSettings) -> dict[tuple[int, int], float]:
    """Squared Mahalanobis distances between known oysters (i, j), i < j, whose centres are within `reach_m`."""
    centres = np.array([track.centre for track in tracks])
    pairs = cKDTree(centres).query_pairs(settings.reach_m, output_type="ndarray")
    if not len(pairs):
        return {}
    i, j = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].T
    covariances = np.array([track.covariance for track in tracks])
    sizes = np.log([track.area_m2 for track in tracks])
    squared = _squared(centres[i] - centres[j], covariances[i] + covariances[j], sizes[i] - sizes[j], settings)
    return dict(zip(zip(i.tolist(), j.tolist(), strict=True), squared.tolist(), strict=True))


def _squared(between: Array, covariances: Array, sizes: Array, settings: MapSettings) -> Array:
    """Squared Mahalanobis distance of differences (..., 3) m, covariances (..., 3, 3) m^2, and of log areas (...)."""
    weighed = np.linalg.solve(covariances, between[..., None])[..., 0]
    return np.asarray((between * weighed).sum(axis=-1) + (sizes / settings.size_sigma) ** 2)
