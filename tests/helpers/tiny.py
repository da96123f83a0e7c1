"""A very small split on a very small rig."""

from __future__ import annotations

from oysterbench.recipe import parse_split

TINY_RIG = """
name = "tiny"
summary = "a small camera and an inertial unit"
truth_rate_hz = 50.0

[imu]
rate_hz = 100.0
gyro_noise_density = 1e-4
gyro_random_walk = 1e-5
gyro_turn_on = 1e-3
accel_noise_density = 1e-3
accel_random_walk = 1e-4
accel_turn_on = 1e-2

[[camera]]
name = "cam_front"
width = 64
height = 48
hfov_deg = 69.0
rate_hz = 10.0
layer_rate_hz = 2.0
position_m = [0.18, 0.0, 0.0]
pitch_deg = 30.0
"""

TINY_SPLIT = """
name = "tiny"
version = "1.0"
track = "slam"
seed = 5
rig = "tiny"
summary = "a very small reef"

[[sequence]]
name = "tiny-01"
duration_s = 2.5

[sequence.reef]
size_m = 5.0
depth_m = 3.0
relief_rms_m = 0.05
oysters = 60
stones = 5

[sequence.water]
jerlov = "1C"

[sequence.light]
sun_elevation_deg = 50.0
sun_azimuth_deg = 200.0

[sequence.path]
kind = "loop"
radius_m = 1.0
speed_m_s = 0.3
ramp_s = 1.0
altitude_m = 0.9
"""


def make_split(text: str = TINY_SPLIT):
    """A split from the text of its recipe, on the tiny rig."""
    return parse_split(text, "tiny.toml", rig_source=TINY_RIG)
