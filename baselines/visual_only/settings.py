"""All constants, with units and reasons."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class VisualOnlySettings:
    """Pixels are those of the image; errors of rays are converted to them by the focal length."""

    # Corners and their tracks.
    clahe_clip: float = 3.0  # contrast limit: turbid water leaves little of it
    clahe_tiles: int = 8
    max_tracks: int = 250
    corner_quality: float = 0.005  # of the best corner in the image
    corner_spacing_px: float = 12.0
    grid: tuple[int, int] = (5, 4)  # columns, rows, each with its share of the tracks
    flow_window_px: int = 21
    flow_levels: int = 4  # 21 px at the fifth level: motions up to 150 px
    backward_error_px: float = 1.0  # there and back again
    min_followed: int = 15  # of the tracks, in a usable frame
    patience_frames: int = 20  # unusable ones that are bridged from the last usable one: 1 s at 20 Hz

    # The first map, of one camera.
    start_parallax_px: float = 40.0  # median
    start_min_points: int = 40
    start_agreement: float = 0.7  # of the frames in between, which must fit the new map
    start_margin: float = 2.0  # least ratio of the error of the second-best motion to that of the best
    start_depth_m: float = 1.5  # median: one camera cannot tell; tilted 30 degrees down, 1 m over the bottom
    essential_error_px: float = 1.0

    # Poses.
    min_inliers: int = 12
    min_inlier_share: float = 0.4
    pose_error_px: float = 2.0
    pose_trials: int = 200

    # A map that is lost.
    begin_again_s: float = 1.0  # without it; a corner that comes back after that has moved out of reach
    speed_s: float = 1.0  # over which the last speed is taken: a stroke of the vehicle's sway

    # Keyframes and landmarks.
    key_parallax_px: float = 20.0  # median, since the last keyframe
    key_share: float = 0.7  # of the landmarks of the last keyframe; fewer make a new one
    min_ray_angle_deg: float = 1.5  # between two views of a landmark
    landmark_error_px: float = 1.5  # in each of its views
    max_views: int = 12  # to which a landmark is fitted, the latest ones

    # Stereo.
    stereo_depths_m: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)  # where the first search starts
    stereo_min_angle_deg: float = 0.5  # 2.6 m with a base of 12 cm is 2.6 deg
    max_base_m: float = 1.0
    max_axes_angle_deg: float = 30.0
    max_stamp_difference_s: float = 0.002  # of the frames of a pair
