"""Automatic exposure and white balance: a control loop over the dive, whose result the frames look up.

The scene is metered a few times a second along the path, once per process, and the loop runs over all frames from the
first: its result is a function of recipe and streams, and frames stay independent of each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.recipe import CameraRecipe, count
from oysterbench.sensors.kind import SensedWorld

if TYPE_CHECKING:
    from oysterbench.render.sensor import Exposure

METER_HZ = 4.0
SILT_METER_HZ = 1.0  # among plumes of silt, which take 50 ms to evaluate at each time
SHORTEST_S = 5e-5
SETTLED = 3.0  # time constants after which a first-order loop has come within 5 % of a step
WAKES, RESTS = 0.2, 0.05  # dead band: stops off the target at which the loop starts to adapt, and at which it rests
FULL_SCALE_LUX_S = 13.9
"""Illuminance of a white surface times exposure time at which an ISO 100 sensor behind an f/2 lens saturates: 4 N^2
0.78 lx s / 0.9 (ISO 12232:2019, saturation-based speed)."""
STEP = 1e-6  # to which logarithms are rounded: far above the last bits, in which the arithmetic of processors differs


@dataclass(frozen=True)
class Exposures:
    """Settings chosen by the loops for N frames: shutter_s (N,), gain (N,), and balance (N, 3) with a mean of 1."""

    shutter_s: Array
    gain: Array
    balance: Array

    def of(self, index: int) -> Exposure:
        """Exposure of frame `index`."""
        from oysterbench.render.sensor import Exposure

        scale = sensitivity() * self.shutter_s[index] * self.gain[index] * self.balance[index]
        return Exposure(float(self.shutter_s[index]), float(self.gain[index]), scale.tolist())


def sensitivity() -> float:
    """Linear signal of a sensor at gain 1, per second and per radiance of a white surface in full daylight."""
    from oysterbench.render.lamps import DAYLIGHT_LUX

    return DAYLIGHT_LUX / FULL_SCALE_LUX_S


def exposures(world: SensedWorld, camera: CameraRecipe) -> Exposures:
    """Exposures of all frames of a camera, computed only once."""
    return world.instrument(camera, lambda: control(camera, metered(world, camera)))


def metered(world: SensedWorld, camera: CameraRecipe) -> Array:
    """Mean radiance (N, 3) that the camera meters at each of its frames."""
    from oysterbench.render.meter import Meter
    from oysterbench.scene.rig import camera_pose

    duration_s = world.recipe.duration_s
    rate_hz = SILT_METER_HZ if world.recipe.water.plumes.attenuation else METER_HZ
    times = np.linspace(0.0, duration_s, max(round(duration_s * rate_hz), 1) + 1)
    meter, mount = Meter(world.renderers[camera.name]), camera_pose(camera)
    bodies = zip(times.tolist(), world.bodies(times), strict=True)
    seen = np.log2([np.maximum(meter.mean(body @ mount, time_s, body), 1e-9) for time_s, body in bodies])
    frames = np.arange(count(duration_s, camera.rate_hz)) / camera.rate_hz
    between = np.stack([np.interp(frames, times, channel) for channel in np.rint(seen.T / STEP) * STEP], axis=1)
    return np.asarray(2.0**between)


def control(camera: CameraRecipe, seen: Array) -> Exposures:
    """Run the control loops on the mean radiance (N, 3) at each frame.

    White balance follows the logarithm of the mean colour, exposure that of its brightness relative to a grey level,
    each with a first-order lag; a frame is exposed according to the metering of earlier frames. Exposure time is raised
    first, up to its limit; gain, in steps, provides the rest.
    """
    from oysterbench.render.light import GREY_LEVEL, white_balance

    target = float(np.log2(GREY_LEVEL) + camera.exposure_stops)
    settle_s = np.array([camera.exposure_settle_s, camera.balance_settle_s])
    adapt, follow = 1.0 - np.exp(-SETTLED / (settle_s * camera.rate_hz))
    colour = np.log2(seen[0])
    balances, levels = np.empty_like(seen), np.empty(len(seen))
    level, moving = 0.0, True
    for k, now in enumerate(seen):
        if k and camera.auto_balance:
            colour = _rounded(colour + follow * (np.log2(seen[k - 1]) - colour))
        balance = white_balance(2.0**colour)
        balances[k] = balance / balance.mean()
        if k == 0:  # the loop has already settled
            level = target - float(np.log2(np.mean(balances[0] * now)))
        else:
            off = target - level - float(np.log2(np.mean(balances[k - 1] * seen[k - 1])))
            moving = abs(off) > (RESTS if moving else WAKES)
            level = float(_rounded(level + adapt * off)) if moving else level
        levels[k] = level
    needed_s = 2.0 ** _rounded(levels) / sensitivity()
    shutter_s = np.clip(needed_s, SHORTEST_S, camera.longest_exposure_ms * 1e-3)
    steps = np.floor(20 * np.log10(np.maximum(needed_s / shutter_s, 1.0)) / camera.gain_step_db + STEP)
    gain: Array = np.minimum(np.power(10.0, steps * camera.gain_step_db / 20), camera.highest_gain)
    return Exposures(np.round(shutter_s, 9), np.round(gain, 6), np.round(balances, 6))


def _rounded(values: Array | float) -> Array:
    return np.asarray(np.rint(np.asarray(values) / STEP) * STEP)
