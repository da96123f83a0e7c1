"""Settings of the visual-inertial baseline. Units are in the names or the comments; comments justify the values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, ClassVar

from oysterbench.core.errors import MethodError


@dataclass(frozen=True)
class FrontEndSettings:
    """Corners, their tracks, and images that are missing or stale."""

    max_tracks: int = 140  # more cost time and gained nothing
    grid: tuple[int, int] = (5, 4)  # columns and rows that share the tracks
    track_spacing_px: float = 18.0  # keeps corners from crowding on the best-lit texture
    corner_block_px: int = 5  # side of the patch that makes a corner
    corner_quality: float = 0.005  # share of the best corner's score; low, since turbid water has little contrast
    veil_px: int = 27  # side of the mean that is subtracted: wider than a patch, narrower than a caustic's web
    contrast_px: int = 55  # side of the window whose spread is divided by
    contrast_floor_grey: float = 3.0  # added to the spread: the sensor's noise, which is not to be amplified
    contrast_grey: float = 40.0  # the spread afterwards
    pattern_pictures: int = 40  # number of images in the mean, in which what does not move stands out
    pattern_step_px: float = 15.0  # motion between these images: half a veil, so that each shows something else
    pattern_sigmas: float = 4.0  # of the mean's own error, beyond which a pixel counts as fixed
    flow_window_px: int = 21  # side of the tracked patch: smaller ones are lost in murk, larger ones slide over relief
    flow_levels: int = 3  # pyramid levels above the image: with the gyroscope's prediction, 80 px of flow
    steady_levels: int = 1  # the same while the flow is steady: coarser levels take half of the time, and help in murk
    steady_share: float = 0.9  # of the tracks, which came through the last frame
    steady_error_px: float = 3.5  # of the last prediction, exceeded by a twentieth of them
    backward_error_px: float = 0.7  # a track must return to where it came from
    epipolar_error_px: float = 1.5  # of verified tracks, at a known rotation
    epipolar_trials: int = 64  # two-point hypotheses: 1e-6 chance to miss with half of the tracks wrong
    motion_sigmas: float = 3.0  # of the vehicle's direction of motion, by which tracks may deviate from it
    motion_sigma: float = 0.03  # m/s, minimum for a velocity known from tracks and IMU alone
    max_gap_s: float = 0.5  # between images; beyond, corners have moved farther than the pyramid reaches
    missing_periods: float = 1.5  # of the camera, after which a frame counts as missing and has its pose without it
    max_blind_s: float = 5.0  # without an image; then no more poses are given: the IMU alone is decimetres off
    repeat_speed: float = 0.05  # m/s, and 5 sigmas, above which an image that repeats the last one is stale
    repeat_px: float = 1.0  # of flow by the gyroscope, beyond what its bias causes, likewise
    rolling_shutter: bool = True  # if the camera has one, take each row at the time of its readout


@dataclass(frozen=True)
class StereoSettings:
    """The second camera."""

    min_baseline_m: float = 0.01
    max_angle_deg: float = 45.0  # between the axes; beyond, patches look too different
    sync_s: float = 1e-3  # frames so near in time were taken together
    depths_m: tuple[float, ...] = (1.0, 2.0, 0.5, 5.0)  # tried first
    epipolar_error_px: float = 1.0  # from the epipolar line


@dataclass(frozen=True)
class KeyframeSettings:
    """When a frame becomes a keyframe."""

    parallax_px: float = 22.0  # median flow without its rotational part
    shared: float = 0.55  # share of the last keyframe's tracks that must be left
    min_s: float = 0.12  # at least two frames of 20 Hz: a single IMU interval has a singular covariance
    max_s: float = 0.5  # bounds the prediction with the IMU alone


@dataclass(frozen=True)
class ZeroVelocitySettings:
    """When tracks say that the vehicle is at rest, and how firmly."""

    flow_px: float = 0.35  # flow between keyframes below this means: not moving
    min_s: float = 0.2  # between the keyframes; over less, slow motion looks like rest
    sigma: float = 0.01  # m/s, 1 sigma of the velocity at rest: 0.35 px in 0.2 s at 3 m
    speed_sigmas: float = 4.0  # of a known velocity, beyond which an image that stands still does not mean rest


@dataclass(frozen=True)
class NoiseSettings:
    """Noise models of observations and of inertial measurements."""

    pixel_sigma_px: float = 1.0  # of a tracked corner, drift over the track's life included
    correlation: float = 3.0  # times that sigma, in covariances of the smoothed path: views err alike, mostly in silt
    views_alike: float = 10.0  # number that say no more about a camera's calibration than one, as errors are correlated
    loss_power: float = 1.0  # of the share of tracks kept per frame: caustics that kill tracks shift those they leave
    max_inflation: float = 4.0  # due to lost tracks, times pixel_sigma_px
    huber: float = 1.3  # sigmas; beyond, a residual counts linearly
    imu_inflation: float = 1.25  # on the densities of the data sheet: interpolation, vibration, scale errors
    bias_inflation: float = 2.0  # on the random walks
    warming_s: float = 5.0  # for which an IMU warms alike, where nothing is seen that corrects its biases
    integration_sigma: float = 1e-4  # m/s/sqrt(s): error of the integration itself; keeps covariances regular


@dataclass(frozen=True)
class CalibrationSettings:
    """Mounts, lenses and the clock of cameras."""

    enabled: bool = True  # estimated with the path, within their stated uncertainty; False keeps them fixed


@dataclass(frozen=True)
class LandmarkSettings:
    """Data association and triangulation."""

    max_turn_deg: float = 20.0  # of the ray to a landmark: seen from another side, a track is another landmark
    min_ray_angle_deg: float = 1.5  # between the rays of a new landmark: 2.6 cm of baseline at 1 m
    max_error_px: float = 3.0  # of a new landmark in each of its views
    min_views: int = 3  # keyframes: two determine a point, the third checks it; a pair takes a caustic for a point
    max_innovation_px: float = 8.0  # from where a landmark was predicted: its track has slid off the point
    max_depth_m: float = 50.0
    min_depth_m: float = 0.1


@dataclass(frozen=True)
class InitialisationSettings:
    """What a start requires, and when it is accepted."""

    min_s: float = 1.5  # shorter windows cannot tell scale from accelerometer bias
    max_keyframes: int = 40  # size of the window that is searched
    min_keyframes: int = 8
    min_tracks: int = 15
    gates_px: tuple[float, ...] = (30.0, 6.0, 3.0)  # of landmarks, from rough states to adjusted ones
    retry_s: float = 0.5  # before the next attempt, after the first one
    retry_growth: float = 1.25  # with each failed attempt
    max_retry_s: float = 3.0
    stereo_s: float = 0.5  # with two cameras the scale is known at once, and this is enough to find the vertical
    stereo_keyframes: int = 3
    scale_sigma: float = 0.03  # accepted 1-sigma uncertainty of scale
    relaxed_scale_sigma: float = 1.0  # at the end of the sequence: a rough scale beats dead reckoning
    max_error_px: float = 2.0  # median reprojection error of an accepted window
    later_error: float = 0.75  # of it, below which the later half alone is right, and what came before was silt


@dataclass(frozen=True)
class WindowSettings:
    """The fixed-lag smoother."""

    keyframes: int = 12  # about 2 s: as long as a corner lives
    iterations: int = 4


@dataclass(frozen=True)
class SmoothingSettings:
    """The final smoothing."""

    iterations: int = 15
    piece_keyframes: int = 200  # a path of two such pieces or more is adjusted piece by piece; a minute or two


@dataclass(frozen=True)
class RecognitionSettings:
    """Place recognition: what is kept of a place, and which places are compared."""

    step_m: float = 0.12  # from one place to the next: a tenth of what an image shows at 1 m
    turn_deg: float = 10.0  # or a rotation by this
    min_landmarks: int = 15  # fewer do not determine the ground plane
    corners: int = 500
    fast_threshold: int = 7  # grey levels, low for turbid water; the best corners are taken anyway
    view_px: int = 400  # side of the ground view
    coarseness: float = 2.0  # size of its pixels, in pixels of the image at its centre
    words: int = 8  # words of a descriptor
    word_bits: int = 18  # two descriptors of one corner, 25 bits apart, share a word in 3 cases of 4
    max_places: int = 300  # beyond, ground that a loop has shown to be known is not stored again
    kept_places: int = 600  # with images and descriptors, some 60 MB; beyond, every other one is dropped
    min_age_s: float = 8.0  # since the place was seen; until then, tracks and window cover it
    candidates: int = 3  # number of places that a place is compared with
    prior_sigmas: float = 4.0  # of odometry's own uncertainty


@dataclass(frozen=True)
class LoopSettings:
    """Verification of loops, the pose graph, and what loops add to the final smoothing."""

    enabled: bool = True  # look for places seen before; False: odometry only
    drift_position: float = 0.012  # m per square root of m
    drift_heading: float = 0.0015  # rad per square root of s
    drift_blind: float = 0.02  # m/s and m/s^2, without tracks
    match_bits: int = 72  # Hamming distance between descriptors of one corner; between two corners, 128 on average
    match_ratio: float = 0.9
    align_share: float = 0.05  # of the distance: by how much aligned corners may miss each other on the ground
    align_trials: int = 400
    align_inliers: int = 8
    flow_window_px: int = 21  # side of the patch by which a landmark is found again
    flow_levels: int = 2  # pyramid levels above the image
    search_px: float = 25.0  # from where the alignment predicts the landmark
    min_inliers: int = 10
    min_share: float = 0.4  # of the landmarks that should be in the image
    retry_m: float = 0.02  # m and rad by which the alignment may be off: beyond, landmarks are looked for again
    strong_inliers: int = 30  # with fewer, a loop between neighbouring places must agree
    neighbours: int = 4  # places
    agree_m: float = 0.05  # m and rad
    min_spread: float = 0.05  # of the image height, 1 sigma of the landmarks along the narrow side of where they are
    pixel_sigma_px: float = 1.5  # of a landmark found again from another side
    cauchy: float = 5.0  # sigmas; beyond, a loop loses weight
    heading_floor: float = 0.002  # rad, 1 sigma: of landmarks and window, added to each loop
    position_floor_m: float = 0.01  # likewise
    iterations: int = 3
    places_per_skip: int = 100  # of the pose graph, for each of which one more loop is skipped before one is added
    merge_px: float = 1.5  # a landmark found again this near a track is that track
    merge_keyframes: int = 100  # that see one landmark, beyond which later passes are tied to its ground instead
    tie_places: int = 4  # between ties, and between the places that they go to
    tie_tilt: float = 0.01  # rad, 1 sigma: of roll and pitch, which loops do not measure


@dataclass(frozen=True)
class RecoverySettings:
    """When the estimate has diverged, and what is known of the time until it has recovered."""

    max_speed: float = 3.0  # m/s; beyond any vehicle meant here
    max_blind_speed: float = 4.0  # times the usual speed, while it sees next to nothing
    max_bias_sigmas: float = 8.0  # of the turn-on bias
    max_lost_share: float = 0.7  # of the landmarks seen, farther than max_innovation_px from their prediction
    max_misfits: int = 10  # tracks with parallax that no point explains, in a keyframe that sees hardly any landmark
    max_bad_keyframes: int = 3  # with so many of either, one after the other, before the estimator restarts
    memory_s: float = 2.0  # for which the last velocity is a guess at the next one
    min_landmarks: int = 8  # in a keyframe; with fewer it knows its velocity by the IMU alone
    blind_speed: float = 1.0  # times the usual speed: 1 sigma of a velocity that nothing measures
    unknown_speed: float = 0.5  # m/s, 1 sigma of the error in velocity where it went astray or is lost
    unknown_rate: float = 0.2  # rad/s, while there are none
    known_bias: float = 0.25  # of the turn-on bias: by how much a bias may be off that was known before a loss


FLAT_NAMES = """
    frontend = max_tracks grid track_spacing_px corner_block_px corner_quality veil_px contrast_px
        contrast_floor_grey contrast_grey flow_window_px flow_levels backward_error_px epipolar_error_px
        epipolar_trials max_gap_s missing_periods coast_s:max_blind_s repeat_speed repeat_px
    stereo = stereo_min_base_m:min_baseline_m stereo_max_angle_deg:max_angle_deg stereo_stamp_s:sync_s
        stereo_depths_m:depths_m stereo_error_px:epipolar_error_px
    keyframes = keyframe_parallax_px:parallax_px keyframe_shared:shared keyframe_min_s:min_s
        keyframe_max_s:max_s
    zero_velocity = rest_px:flow_px rest_s:min_s rest_speed:sigma
    noise = pixel_sigma_px alike:correlation spread_power:loss_power max_spread:max_inflation huber
        imu_inflation bias_inflation integration_sigma
    landmarks = max_turn_deg min_ray_angle_deg max_landmark_error_px:max_error_px min_views
        max_slide_px:max_innovation_px max_depth_m min_depth_m
    initialisation = init_min_s:min_s init_max_keyframes:max_keyframes init_min_keyframes:min_keyframes
        init_min_tracks:min_tracks init_gates_px:gates_px init_retry_s:retry_s init_stereo_s:stereo_s
        init_stereo_keyframes:stereo_keyframes init_scale_sigma:scale_sigma
        init_relaxed_scale_sigma:relaxed_scale_sigma init_max_error_px:max_error_px
    window = lag_keyframes:keyframes lag_iterations:iterations
    smoothing = smoothing_iterations:iterations
    recognition = place_step_m:step_m place_turn_deg:turn_deg place_landmarks:min_landmarks
        place_corners:corners place_fast_threshold:fast_threshold place_view_px:view_px
        place_coarseness:coarseness place_words:words place_word_bits:word_bits most_places:max_places
        loop_min_s:min_age_s loop_candidates:candidates loop_prior_sigmas:prior_sigmas
    loops = loops:enabled drift_position drift_heading drift_blind match_bits match_ratio align_share
        align_trials align_inliers loop_window_px:flow_window_px loop_levels:flow_levels
        loop_search_px:search_px loop_inliers:min_inliers loop_share:min_share loop_again_m:retry_m
        loop_strong:strong_inliers loop_neighbours:neighbours loop_agree_m:agree_m loop_spread:min_spread
        loop_pixel_sigma:pixel_sigma_px loop_cauchy:cauchy loop_heading_floor:heading_floor
        loop_floor_m:position_floor_m loop_iterations:iterations loop_places:places_per_skip merge_px
        merge_keyframes tie_places tie_tilt
    recovery = max_speed max_bias_sigmas max_lost_share max_bad_keyframes unknown_speed unknown_rate
"""
"""Names of the options before they were nested, by part; `old:new` where the last word has changed."""


SIGMAS = ("sigma", "sigma_px", "sigmas", "huber", "cauchy", "correlation", "views_alike", "imu_inflation", "iterations")
"""Endings of the names of settings that are divided by, or done at least once."""


def check_ranges(settings: Any, part: str = "") -> None:
    """Raise MethodError if a number in settings, a dataclass of parts, is negative, or zero where it must not be."""
    for field_ in fields(settings):
        name, value = f"{part}{field_.name}", getattr(settings, field_.name)
        if is_dataclass(value):
            check_ranges(value, f"{name}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            positive = field_.name.endswith(SIGMAS)
            if not value >= 0 or (positive and value == 0):
                raise MethodError(f"option {name}: expected {'more than 0' if positive else '0 or more'}, got {value}")


def renamed_options(flat_names: str) -> dict[str, str]:
    """Nested option name by flat name."""
    names, part = dict[str, str](), ""
    words = flat_names.split()
    for word, following in zip(words, [*words[1:], ""], strict=True):
        if following == "=":
            part = word
        elif word != "=":
            old, _, new = word.partition(":")
            names[old] = f"{part}.{new or old}"
    return names


@dataclass(frozen=True)
class GtsamViSettings:
    """All settings, by part. None depends on the sequence: what does is taken from its calibrations."""

    renamed: ClassVar[Mapping[str, str]] = renamed_options(FLAT_NAMES)

    frontend: FrontEndSettings = field(default_factory=FrontEndSettings)
    stereo: StereoSettings = field(default_factory=StereoSettings)
    keyframes: KeyframeSettings = field(default_factory=KeyframeSettings)
    zero_velocity: ZeroVelocitySettings = field(default_factory=ZeroVelocitySettings)
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    landmarks: LandmarkSettings = field(default_factory=LandmarkSettings)
    initialisation: InitialisationSettings = field(default_factory=InitialisationSettings)
    window: WindowSettings = field(default_factory=WindowSettings)
    smoothing: SmoothingSettings = field(default_factory=SmoothingSettings)
    recognition: RecognitionSettings = field(default_factory=RecognitionSettings)
    loops: LoopSettings = field(default_factory=LoopSettings)
    recovery: RecoverySettings = field(default_factory=RecoverySettings)

    def __post_init__(self) -> None:
        check_ranges(self)
