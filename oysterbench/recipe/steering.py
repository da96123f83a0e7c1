"""Commands of a policy that explores a reef, and how its rollouts are scored: the table `[steering]`."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from oysterbench.core.errors import RecipeError
from oysterbench.recipe.keys import number


@dataclass(frozen=True, kw_only=True)
class SteeringRecipe:
    """A command is a class of yaw and a class of pitch, which say by how much the course turns during the next step.

    The vehicle flies where its bow points, at constant speed over the ground.
    """

    yaw_deg: tuple[float, ...] = number(-90.0, 90.0)
    """Change of heading of each class, positive to the left; in order from left to right, as in the image."""
    pitch_deg: tuple[float, ...] = number(-90.0, 90.0)
    """Change of pitch of each class, positive bow down; in order from up to down."""
    max_pitch_deg: float = number(0.0, 80.0, 30.0)
    """Steepest climb and descent."""
    step_s: float = number(0.1, 10.0, 1.0)
    """Time from one command to the next."""
    speed_m_s: float = number(0.01, 3.0, 0.5)  # Constant speed over the ground.
    altitude_m: tuple[float, float] = number(0.1, 20.0)
    """Lowest and highest altitude over the bottom: the band that a policy should stay in."""
    view_range_m: float = number(0.2, 10.0, 2.0)
    """Greatest distance from the camera at which an oyster counts as seen."""
    view_lengths: float = number(0.5, 10.0, 3.0)
    """The same in attenuation lengths of the water; the smaller distance applies."""
    view_px: int = number(1, 10_000, 20)
    """Least number of pixels in the image for an oyster to count as seen."""
    hull_m: float = number(0.05, 1.0, 0.2)
    """Radius of the sphere around the vehicle that must touch nothing."""
    fence_m: float = number(0.0, 10.0, 1.0)
    """Distance of the fence of a rollout from the reef's edge: there the vehicle is reflected like a ball."""
    rollout_s: float = number(1.0, 3600.0, 120.0)
    """Length of a rollout."""


def check_steering(task: SteeringRecipe, where: str) -> None:
    """Check what no single key can express. Raises RecipeError, which starts with `where`."""
    for key, falls in (("yaw_deg", True), ("pitch_deg", False)):
        degrees = getattr(task, key)
        steps = [b - a for a, b in pairwise(degrees)]
        if len(degrees) < 3 or 0.0 not in degrees or not all((step < 0) == falls and step for step in steps):
            order = "falling (from left to right)" if falls else "rising (from up to down)"
            raise RecipeError(
                f"{where}: key 'steering.{key}': expected at least 3 {order} values, 0 among them, got {list(degrees)}"
            )
    if task.altitude_m[0] >= task.altitude_m[1]:
        raise RecipeError(
            f"{where}: key 'steering.altitude_m': expected the lowest and the highest, got {list(task.altitude_m)}"
        )
