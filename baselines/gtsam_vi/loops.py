"""Loop closure: recognising places, verifying that they are the same, and correcting the path.

A loop has to pass, in this order: shared words; distance, by the odometry's own uncertainty; a rigid, level alignment
of the matched corners in metres; and landmarks of the old place, many and widely spread, found again in the new image
by Lucas-Kanade to a fraction of a pixel where that alignment predicts them. What a self-similar reef repeats passes the
first test, but not the last.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, invert
from oysterbench.sequence.types import CameraCalibration
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.merging import LoopClosure, join
from oysterbench_baselines.gtsam_vi.places import (
    GroundViewer,
    Index,
    Place,
    decode,
    encode,
    fit_ground,
    heading_of,
    heading_pose,
    landmarks_of,
    level_pose,
)
from oysterbench_baselines.gtsam_vi.posegraph import Drift, PoseGraph
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings
from oysterbench_baselines.gtsam_vi.states import Keyframe, State, make_state
from oysterbench_baselines.gtsam_vi.verification import Verifier


@dataclass
class LoopCloser:
    """Loop closing for the estimator's keyframes: makes places of them, looks for loops, maintains the pose graph."""

    calibration: CameraCalibration
    model: Model
    settings: GtsamViSettings
    places: list[Place] = field(default_factory=list)
    loops: list[LoopClosure] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.viewer = GroundViewer(self.calibration, self.settings)
        self.index = Index(self.settings)
        self.verifier = Verifier(self.calibration, self.settings)
        self.graph = PoseGraph(self.settings)
        self._waiting: list[tuple[int, bytes]] = []  # keyframes whose state is not known yet, with their images
        self._settled = 0  # places in the pose graph: their keyframes have left the window
        self._centres: list[Array] = []  # centre of the ground view of each place, in its level frame
        self._kept: list[int] = []  # places that have not been forgotten
        self._weak: list[LoopClosure] = []  # loops with few landmarks, which wait for a neighbour that agrees

    @property
    def correction(self) -> Array:
        """T_corrected_odom (4, 4) for the window's current estimate."""
        return self.graph.correction

    def ties(self, k: int) -> bool:
        """Whether a loop connects what was seen from keyframe k on to what was seen before."""
        return any(self.places[loop.first].keyframe < k <= self.places[loop.second].keyframe for loop in self.loops)

    def add_keyframe(self, keyframes: list[Keyframe], picture: NDArray[np.uint8]) -> None:
        """Process the newest keyframe, its state already up to date, and its equalised image (H, W) uint8."""
        self._waiting.append((keyframes[-1].index, encode(picture)))
        if keyframes[-1].state is None:
            self._waiting = self._waiting[-self.settings.initialisation.max_keyframes :]
            return
        self._settle(keyframes)
        limit = self.settings.recognition.max_places
        for k, stored in self._waiting:
            if keyframes[k].state is None:
                continue
            place = self._make_place(keyframes, k, stored, picture if k == keyframes[-1].index else None)
            if place is None:
                continue
            self.places.append(place)
            self._centres.append(np.median(place.points, axis=0))
            if k == keyframes[-1].index and self._find_loops(keyframes, picture) and len(self.places) > limit:
                place.forget()
            self.index.add(place.descriptors)
            if not place.forgotten:
                self._kept.append(len(self.places) - 1)
            if len(self._kept) > self.settings.recognition.kept_places:
                self._thin_out()
        self._waiting = []

    def _thin_out(self) -> None:
        """Forget every other place that is kept: the path of a long dive is then recognised at twice the step."""
        for n in self._kept[1::2]:
            self.places[n].forget()
            self.index.forget(n)
        self._kept = self._kept[::2]

    def _make_place(
        self, keyframes: list[Keyframe], k: int, coded: bytes, picture: NDArray[np.uint8] | None
    ) -> Place | None:
        """Make a place of a keyframe; None if the vehicle has hardly moved since the last one or landmarks are few."""
        settings, pose = self.settings, keyframes[k].estimate.matrix
        if self.places:
            last = keyframes[self.places[-1].keyframe].estimate.matrix
            moved = np.linalg.norm(pose[:3, 3] - last[:3, 3])
            turned = np.arccos(np.clip((np.trace(last[:3, :3].T @ pose[:3, :3]) - 1) / 2, -1, 1))
            if moved < settings.recognition.step_m and turned < np.radians(settings.recognition.turn_deg):
                return None
        ids, rays, points = landmarks_of(self.model, keyframes, k, settings.window.keyframes)
        if len(ids) < settings.recognition.min_landmarks:
            return None
        level = invert(level_pose(pose))
        local = points @ level[:3, :3].T + level[:3, 3]
        T_level_cam = level @ pose @ self.model.rig.T_imu_cam
        plane = fit_ground(local)
        if picture is None:
            picture = decode(coded)
        descriptors, corners = self.viewer.describe(picture, rays, local, T_level_cam, plane)
        return Place(k, T_level_cam, plane, ids, rays, local, descriptors, corners, coded)

    def _settle(self, keyframes: list[Keyframe]) -> None:
        """Update places whose keyframes have left the window with their last states and landmarks seen from both sides,
        and add them to the pose graph."""
        settings = self.settings
        while self._settled < len(self.places):
            place = self.places[self._settled]
            if place.keyframe > len(keyframes) - 1 - settings.window.keyframes:
                break
            pose = keyframes[place.keyframe].estimate.matrix
            level = level_pose(pose)
            if not place.forgotten:
                self._bring_up_to_date(place, keyframes, level)
            self.graph.add(level, self._drift(keyframes, self._settled))
            self._settled += 1

    def _bring_up_to_date(self, place: Place, keyframes: list[Keyframe], level: Array) -> None:
        """Update landmarks and ground of a place from the last state of its keyframe, whose level pose is `level`."""
        settings = self.settings
        ids, rays, points = landmarks_of(self.model, keyframes, place.keyframe, settings.window.keyframes)
        if len(ids) >= settings.recognition.min_landmarks:
            back = invert(level)
            place.ids, place.rays, place.points = ids, rays, points @ back[:3, :3].T + back[:3, 3]
            place.T_level_cam = back @ keyframes[place.keyframe].estimate.matrix @ self.model.rig.T_imu_cam
            place.plane = fit_ground(place.points)

    def _drift(self, keyframes: list[Keyframe], n: int) -> Drift:
        """Drift over the step to place n: a random walk, more where little was visible, far more where tracking was
        lost."""
        settings = self.settings
        if n == 0:
            return Drift(0.0, 0.0)
        before, after = keyframes[self.places[n - 1].keyframe], keyframes[self.places[n].keyframe]
        distance = float(np.linalg.norm(after.estimate.matrix[:3, 3] - before.estimate.matrix[:3, 3]))
        duration = (after.stamp_ns - before.stamp_ns) * 1e-9
        between = keyframes[before.index + 1 : after.index + 1]
        seen = settings.recognition.min_landmarks
        blind = sum(k.segment.duration for k in between if len(k.observations.ids) < seen and not k.lost)
        lost = sum(k.segment.duration for k in between if k.lost)
        heading = settings.loops.drift_heading**2 * duration + (settings.recovery.unknown_rate * lost) ** 2
        position = settings.loops.drift_position**2 * (distance + 0.01 * duration)
        position += (settings.loops.drift_blind * (blind + blind**2)) ** 2 + (
            settings.recovery.unknown_speed * lost
        ) ** 2
        return Drift(heading, position)

    def _find_loops(self, keyframes: list[Keyframe], picture: NDArray[np.uint8]) -> bool:
        """Find loops between the newest place and settled ones; return whether one of them leaves no doubt."""
        settings = self.settings
        now = len(self.places) - 1
        place = self.places[now]
        if self._settled < 2:
            return False
        anchor = self._settled - 1  # the newest place in the graph; the window ties the newest of all to it
        T_anchor_now = invert(self.graph.odometry[anchor]) @ level_pose(keyframes[place.keyframe].estimate.matrix)
        T_odom_now = self.graph.poses[anchor] @ T_anchor_now
        candidates, certain = self._candidates(keyframes, now, anchor, T_odom_now), False
        for n in candidates:
            loop = self._verify(n, now, anchor, T_odom_now, picture)
            if loop is None:
                continue
            if len(loop.ids) < settings.loops.strong_inliers and not self._has_neighbour(keyframes, loop):
                self._weak.append(loop)
                continue
            self.loops.append(loop)
            T = loop.T_first_second @ invert(T_anchor_now)
            covariance = loop.covariance + np.diag(
                [settings.loops.heading_floor**2] + [settings.loops.position_floor_m**2] * 3
            )
            self.graph.close(n, anchor, T, covariance)
            certain |= len(loop.ids) >= settings.loops.strong_inliers
        return certain

    def rest(self) -> None:
        """Release all that recognises places and keep what `joined` needs: no keyframe will follow."""
        for place in self.places:
            place.forget()
        self.index = Index(self.settings)
        self.graph.rest()
        self._waiting = []

    def joined(self, keyframes: list[Keyframe]) -> list[Keyframe]:
        """Return the keyframes with the loops applied: states of the pose graph, merged tracks, ties."""
        if not self.loops:
            return keyframes
        corrected = [replace(k, state=_moved(k.estimate, self._correction_at(k.index))) for k in keyframes]
        return join(corrected, self.places, self.loops, self.model)

    def _correction_at(self, k: int) -> Array:
        """T_corrected_odom (4, 4) at a keyframe: between places, interpolated between theirs."""
        places = [place.keyframe for place in self.places[: self._settled]]
        after = int(np.searchsorted(places, k))
        before = max(0, after - 1)
        after = min(after, self._settled - 1)
        first, second = (self.graph.poses[n] @ invert(self.graph.odometry[n]) for n in (before, after))
        if before == after:
            return first
        share = (k - places[before]) / (places[after] - places[before])
        # A share of the difference between the two corrections, about the place before, which it hardly moves.
        step = invert(first) @ second
        heading = share * heading_of(step)
        centre = self.graph.odometry[before][:3, 3]
        end = step[:3, :3] @ centre + step[:3, 3] - centre
        part = heading_pose(heading, np.zeros(3))
        part[:3, 3] = centre + share * end - part[:3, :3] @ centre
        return first @ part

    def _has_neighbour(self, keyframes: list[Keyframe], loop: LoopClosure) -> bool:
        """Whether another loop between neighbours of its places agrees, as odometry is certain over so few places."""
        settings = self.settings
        level = [level_pose(keyframes[self.places[n].keyframe].estimate.matrix) for n in (loop.first, loop.second)]
        for other in [*self._weak, *self.loops][-4 * settings.loops.neighbours * settings.recognition.candidates :]:
            apart = max(abs(other.first - loop.first), abs(other.second - loop.second))
            if apart > settings.loops.neighbours or other.second == loop.second:
                continue
            ends = [level_pose(keyframes[self.places[n].keyframe].estimate.matrix) for n in (other.first, other.second)]
            predicted = invert(level[0]) @ ends[0] @ other.T_first_second @ invert(ends[1]) @ level[1]
            off = invert(predicted) @ loop.T_first_second
            if np.linalg.norm(off[:3, 3]) < settings.loops.agree_m and abs(heading_of(off)) < settings.loops.agree_m:
                return True
        return False

    def _candidates(self, keyframes: list[Keyframe], now: int, anchor: int, T_odom_now: Array) -> list[int]:
        """Settled places, long enough ago, whose ground may be in view now; best by votes."""
        settings = self.settings
        stamp = keyframes[self.places[now].keyframe].stamp_ns
        votes = self.index.votes(self.places[now].descriptors)[: anchor + 1]
        here = T_odom_now[:3, :3] @ self._centres[now] + T_odom_now[:3, 3]
        reach = 0.5 * settings.recognition.view_px * (self.viewer.resolution or 0.0)
        good: list[int] = []
        for n in np.argsort(-votes, kind="stable"):
            n = int(n)
            if votes[n] <= 0 or len(good) == settings.recognition.candidates:
                break
            age = (stamp - keyframes[self.places[n].keyframe].stamp_ns) * 1e-9
            if age < settings.recognition.min_age_s:
                continue
            if any(abs(n - other) <= 2 for other in good):
                continue
            T = self.graph.poses[n]
            apart = np.linalg.norm((T[:3, :3] @ self._centres[n] + T[:3, 3] - here)[:2])
            sigma = self.graph.uncertainty(n, anchor)[1]
            if apart > 1.5 * reach + settings.recognition.prior_sigmas * sigma:
                continue
            good.append(n)
        return good

    def _verify(
        self, n: int, now: int, anchor: int, T_odom_now: Array, picture: NDArray[np.uint8]
    ) -> LoopClosure | None:
        settings, first, second = self.settings, self.places[n], self.places[now]
        T, agree = self.verifier.align(first, second)
        if agree < settings.loops.align_inliers:
            return None
        confirmed = self.verifier.confirm(first, second, T, picture)
        if confirmed is None:
            return None
        T, covariance, index, pixels, rays = confirmed
        # By how much it contradicts odometry.
        heading_sigma, sigma = self.graph.uncertainty(n, anchor)
        off = invert(invert(self.graph.poses[n]) @ T_odom_now) @ T
        if abs(heading_of(off)) > settings.recognition.prior_sigmas * (heading_sigma + settings.loops.heading_floor):
            return None
        if np.linalg.norm(off[:3, 3]) > settings.recognition.prior_sigmas * (sigma + settings.loops.position_floor_m):
            return None
        return LoopClosure(n, now, T, covariance, first.ids[index], pixels, rays)


def _moved(state: State, T: Array) -> State:
    """Transform a state by a rotation about z and a translation (4, 4)."""
    pose = T @ state.matrix
    bias = state.bias
    velocity = T[:3, :3] @ state.nav.velocity()
    return make_state(pose[:3, :3], pose[:3, 3], velocity, bias.gyroscope(), bias.accelerometer())
