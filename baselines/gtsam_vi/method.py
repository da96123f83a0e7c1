"""The methods, with one camera or two: a sequence is fed through front end and estimator in time order.

From top to bottom: what a method is and runs; how samples are fed to it; how the result is assembled.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, Literal

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array
from oysterbench.core.measurements import Image
from oysterbench.methods import Estimate
from oysterbench.sequence.types import CameraCalibration, ImuMeasurement, Sequence
from oysterbench_baselines.common.checks import check_inertial, on_imu_clock
from oysterbench_baselines.common.inertial import SampleBuffer, Segment, relative_rotation
from oysterbench_baselines.gtsam_vi.calibration import CameraUncertainty
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.frontend import FeatureTracks, FrontEnd
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings
from oysterbench_baselines.gtsam_vi.stereo import StereoMatcher, pairs, second_camera
from oysterbench_baselines.moving import MovingMask, mask_weights

Output = Literal["smoothed", "online"]


class GtsamVi:
    """Visual-inertial odometry on GTSAM: KLT tracks, preintegrated inertial factors, a fixed-lag smoother.

    output: "smoothed" gives the poses after an adjustment of the whole path, "online" those known at each frame, but
    before the first start those known at that start.
    camera: name of the camera; the first one by default. stereo: use a second camera beside it as well.
    seed: of the random samples in the epipolar check. mask: "moving", or a file of weights, to leave out what
    moves in an image, as detected by a network from `oysterbench train moving`; empty: nothing is left out.
    """

    name = "gtsam_vi"
    track = "slam"

    def __init__(
        self,
        output: Output = "smoothed",
        camera: str | None = None,
        settings: GtsamViSettings | None = None,
        stereo: bool = False,
        seed: int = 0,
        mask: str = "",
    ) -> None:
        check_output(self.name, output)
        self.output, self.camera, self.stereo, self.seed, self.mask = output, camera, stereo, seed, mask
        self.settings = settings or GtsamViSettings()
        self.about = {
            "sensors": ["stereo" if stereo else "mono", "imu"],
            "online": output == "online",
            "code": "baselines/gtsam_vi",
        }

    @property
    def weights(self) -> dict[str, Path]:
        """Files of the trained weights that it uses: those of the mask."""
        return mask_weights(self.mask)

    def run(self, sequence: Sequence) -> Estimate:
        """Poses T_odom_base at the camera's stamps, for some seconds also where frames are missing; and the map."""
        check_inertial(self.name, sequence)
        cameras = [first_camera(self.name, sequence, self.camera)]
        if self.stereo:
            second = second_camera(sequence, cameras[0], self.settings.stereo)
            if second is None:
                raise MethodError(
                    f"{self.name}: sequence {sequence.name} has no second camera that looks where {cameras[0]!r} "
                    f"looks, with images of the same size; cameras: {', '.join(sequence.cameras)}; with one camera "
                    "run gtsam_vi"
                )
            cameras.append(second)
        calibrations = [sequence.cameras[camera] for camera in cameras]
        stated = sequence.uncertainty if self.settings.calibration.enabled else None
        uncertainty = CameraUncertainty.of(stated, cameras, calibrations)
        estimator = Estimator(calibrations, sequence.imu_calibration, self.settings, uncertainty=uncertainty)
        front_end = self.front_end(calibrations[0])
        run_estimator(estimator, sequence, cameras, sequence.stream(*cameras), self.seed, front_end=front_end)
        return estimate_of(estimator, self.output, self.settings, {"cameras": cameras})

    def front_end(self, calibration: CameraCalibration) -> FrontEnd:
        """Front end that tracks corners in the images of a camera."""
        return FrontEnd(calibration, self.settings.frontend, self.seed, moving_mask(self.mask))


class GtsamViStereo(GtsamVi):
    """`GtsamVi` with the second camera of a stereo pair as well."""

    name = "gtsam_vi_stereo"

    def __init__(
        self,
        output: Output = "smoothed",
        camera: str | None = None,
        settings: GtsamViSettings | None = None,
        seed: int = 0,
        mask: str = "",
    ) -> None:
        super().__init__(output, camera, settings, True, seed, mask)


def moving_mask(weights: str) -> MovingMask | None:
    """Mask of what moves, from a network's weights; None if these are empty."""
    return MovingMask(weights) if weights else None


def check_output(method: str, output: str) -> None:
    """Raise MethodError if a method cannot give the requested path."""
    if output not in ("smoothed", "online"):
        raise MethodError(f"{method}: expected output 'smoothed' or 'online', got {output!r}")


def first_camera(method: str, sequence: Sequence, camera: str | None) -> str:
    """Name of the camera, by default that of the first one. Raises MethodError where there is none."""
    camera = camera or next(iter(sequence.cameras), "")
    if camera not in sequence.cameras:
        which = f" {camera!r}; cameras: {', '.join(sequence.cameras) or 'none'}" if camera else ""
        raise MethodError(f"{method}: sequence {sequence.name} has no camera{which}")
    return camera


def run_estimator(
    estimator: Estimator,
    sequence: Sequence,
    cameras: list[str],
    stream: Iterator[Any],
    seed: int,
    start_ns: int | None = None,
    front_end: FrontEnd | None = None,
) -> None:
    """Feed an estimator with a stream of a sequence, from the first to the last sample.

    cameras: one, or two. start_ns: if given, there are poses from then to the very end, with or without images; if
    None, a missing frame has one only within `max_blind_s` of the last image. front_end: of the first camera; by
    default that of the settings.
    """
    settings, calibration = estimator.settings, sequence.cameras[cameras[0]]
    front_end = front_end or FrontEnd(calibration, settings.frontend, seed)
    second = cameras[1] if len(cameras) > 1 else None
    matcher = None if second is None else StereoMatcher(calibration, sequence.cameras[second], settings)
    R_imu_cam = estimator.model.rig.T_imu_cam[:3, :3]
    patience_ns = settings.frontend.missing_periods / calibration.rate_hz * 1e9
    samples, first_imu_ns = SampleBuffer(), next(sequence.imu()).stamp_ns
    together = False  # whether there were images while there were inertial samples
    since_image = list[Segment]()
    last_ns = latest_ns = start_ns or 0  # of the last frame, and of the last inertial sample
    seen_ns: int | None = None  # of the last image
    stream = on_imu_clock(stream, {camera: sequence.cameras[camera] for camera in cameras})
    for item in pairs(stream, cameras[0], second, settings.stereo.sync_s):
        image, other = item if isinstance(item, tuple) else (None, None)
        stamp_ns: int = item.stamp_ns if image is None else image.stamp_ns
        if stamp_ns < first_imu_ns - 1e9 / sequence.imu_calibration.rate_hz:
            continue  # nothing is known of the motion from here to the first inertial sample
        together |= image is not None and stamp_ns < latest_ns + patience_ns
        if isinstance(item, ImuMeasurement):
            samples.add(item)
            latest_ns = stamp_ns
            blind = seen_ns is None or stamp_ns - seen_ns > settings.frontend.max_blind_s * 1e9
            if stamp_ns - last_ns < patience_ns or (start_ns is None and blind):
                continue
        elif image is not None and estimator.frames and stamp_ns <= last_ns:
            continue  # too late: a pose has been given in its place
        segment = samples.cut(stamp_ns)
        estimator.propagate(segment)
        since_image.append(segment)
        if image is None:
            if isinstance(item, ImuMeasurement):  # an image is missing
                estimator.step(stamp_ns)
                last_ns = stamp_ns
            else:
                estimator.update(item)
            continue
        since = Segment.join(since_image)  # not per sample: without images it is all of the dive
        if front_end.repeats(image.pixels) and estimator.has_moved(since):
            estimator.step(stamp_ns)  # it is stale
        else:
            turn = R_imu_cam.T @ relative_rotation(since, estimator.gyro_bias) @ R_imu_cam
            tracks = front_end.track(image.pixels, turn, since.duration, estimator.moved(stamp_ns, since.duration))
            seen_ns, since_image = stamp_ns, []
            match = None
            if matcher is not None and other is not None:
                match = partial(_match, matcher, front_end, tracks, other)
            estimator.step(stamp_ns, tracks, match, front_end.image, image.pixels)
        last_ns = stamp_ns
    if start_ns is not None and latest_ns > last_ns:
        estimator.propagate(samples.cut(latest_ns))
        estimator.step(latest_ns)
    if start_ns is None and not together:
        raise MethodError(
            f"expected images of {cameras[0]} in sequence {sequence.name} while inertial samples were taken, from "
            f"{first_imu_ns * 1e-9:.3f} to {latest_ns * 1e-9:.3f} s, got none; are both stamped by the same clock?"
        )
    if samples.refused:
        estimator.info["imu_refused"] = samples.refused
    estimator.finish()


def estimate_of(estimator: Estimator, output: Output, settings: GtsamViSettings, info: dict[str, Any]) -> Estimate:
    """Estimate of a method: the path named `output`, the other one beside it, the map and the health."""
    paths = estimator.paths()
    others = {name: path for name, path in paths.items() if name != output and len(path)}
    info = {"trajectory": output, **info, **estimator.info, "settings": dataclasses.asdict(settings)}
    return Estimate(paths[output], info, output, others, estimator.map(), estimator.health(output))


def _match(matcher: StereoMatcher, front_end: FrontEnd, tracks: FeatureTracks, other: Image) -> Array:
    assert front_end.image is not None
    rays = matcher.match(front_end.image, front_end.equalise(other.pixels), tracks)
    return rays if tracks.rolled is None else rays - tracks.rolled  # the rows of a pair are read out together
