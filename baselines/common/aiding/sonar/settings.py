"""Settings of an imaging sonar that calibrations do not give: of its images, and of their registration."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class FanSettings:
    """From the echoes of a fan to an image of the bottom's texture."""

    smooth_px: float = 1.2  # bins and beams, 1 sigma: fully developed speckle is white, and has a tenth of this left
    veil_m: float = 0.6  # of range, and
    veil_deg: float = 20.0  # of azimuth, over which the mean is subtracted: beam pattern and gain are wider, stones not
    floor_db: float = 3.0  # over one count of power: below, there is only noise
    highest_deg: float = 20.0  # over the sonar's axis, and
    lowest_deg: float = 4.6  # below it, from where the bottom is believed: nearer, its first echo goes with the vehicle
    reach_m: float = 6.0  # over ground: farther, a beam of a degree is as wide as a clump of oysters


@dataclass(frozen=True)
class ChartSettings:
    """The image of the ground that the latest fans make together."""

    cell_m: float = 0.04  # two bins; a beam of a degree is as wide at 2.3 m
    cells: int = 384  # per side: 15 m, so that what the fan sees of it never lies at its edge
    memory: float = 6.0  # fans: more would blur what relief shifts, fewer leave speckle


@dataclass(frozen=True)
class RegistrationSettings:
    """How a fan is registered on the chart, and when the two do not belong together."""

    iterations: int = 12
    tolerance_m: float = 2e-4
    tolerance_rad: float = 1e-4
    most_cells: int = 12000  # of the steepest: the rest says little and costs time
    least_cells: int = 500
    cauchy: float = 2.0  # sigmas of the differences between cells: the edges of shadows move over the ground
    basin_m: float = 0.08  # largest error, 3 sigmas, from which the steps find the place; beyond, it is searched for
    most_search_m: float = 1.0  # largest radius of the search
    yaw_slack: float = 0.01  # rad, besides 3 sigmas, by which the heading may deviate from the gyroscopes
    least_alike: float = 0.3  # correlation of a fan with the chart; good ones have 0.6 to 0.9
    rival: float = 0.85  # of the best place's correlation, at which a second one makes it doubtful
    rival_m: float = 0.3  # from the best; nearer, it is the same hill
    alike: float = 5.0  # times the sigma that white noise would leave: neighbouring cells, and what relief shifts, err
    # together (measured on slam-train: 4 mm forward, 3 mm sideways and 1 mrad)


@dataclass(frozen=True)
class GroundSettings:
    """Height of the plane of the bottom."""

    memory_s: float = 3.0  # of soundings that make it: the vehicle reaches what the fan sees some seconds later
    standing_m: float = 0.08  # over the soundings' mean: hills and shells send echoes, hollows lie in their shadow
    near_share: float = 0.5  # of the strongest range, at which a fan's bottom starts: where nothing else sounds it


@dataclass(frozen=True)
class SonarLoopSettings:
    """Ground that is seen again."""

    enabled: bool = True
    step_m: float = 0.8  # path length between places that are stored
    least_way_m: float = 6.0  # path length between the places of a loop: nearer ones are on one chart
    apart_m: float = 2.5  # largest distance between the centres of what the places show
    candidates: int = 3  # charts on which a place is looked for
    drift: float = 0.01  # 1 sigma of the path, per metre travelled in between
    turn_sigma: float = 0.02  # rad, of the heading in between
    neighbours: int = 3  # places no farther apart than this confirm each other's loops
    agree_m: float = 0.1  # by which their loops may differ on the error of the path
    sigma_m: float = 0.03  # of a loop, at least: what relief shifts from one side to the other
    cauchy: float = 1.0  # sigmas; a loop that all others contradict loses its weight
    registration: RegistrationSettings = field(default_factory=lambda: RegistrationSettings(most_search_m=2.0))


@dataclass(frozen=True)
class SonarSettings:
    """An imaging sonar as odometry."""

    fan: FanSettings = field(default_factory=FanSettings)
    chart: ChartSettings = field(default_factory=ChartSettings)
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    ground: GroundSettings = field(default_factory=GroundSettings)
    loops: SonarLoopSettings = field(default_factory=SonarLoopSettings)
    scale_sigma: float = 0.02  # of 1: mean relative error of the bottom's height; slam-train has 0 to 2.7 %
    mount_sigma_deg: float = 0.5  # of its heading, besides what the calibration states
    position_floor_m: float = 0.002  # 1 sigma of a registration, at least
    heading_floor: float = 0.0005  # rad, likewise
    drift: float = 0.012  # m per square root of m, by which the chart drifts as it is passed on: relief shifts alike
    drift_heading: float = 0.001  # rad, likewise: gyroscopes, and what is left of their bias
    gyro_walk: float = 3e-4  # rad/sqrt(s), by which gyroscopes lose the heading from ping to ping
    longest_m: float = 1.5  # between keyframes that a factor ties
    max_delay_s: float = 0.3  # a ping older than this does not count for a keyframe
    silence_s: float = 1.0  # without a DVL's velocity, after which the sonar counts: the log is five times better
    patience_s: float = 2.0  # without a registration, after which the chart is started anew
    huber: float = 3.0  # sigmas; beyond, a residual in the graph counts linearly
