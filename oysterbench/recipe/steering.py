"""What a policy that explores a reef commands, and what its rollouts are measured by: the table `[steering]`."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from oysterbench.core.errors import RecipeError
from oysterbench.recipe.keys import number


@dataclass(frozen=True, kw_only=True)
class SteeringRecipe:
    """A command is a class of yaw and a class of pitch: by how much the course turns during the next step.

    The vehicle flies where its bow points, at constant speed over the ground.
    """

    yaw_deg: tuple[float, ...] = number(-90.0, 90.0)
    """Turn of the heading of each class, to the left positive; from left to right, as they lie in the picture."""
    pitch_deg: tuple[float, ...] = number(-90.0, 90.0)
    """Turn of the pitch of each class, bow down positive; from up to down."""
    max_pitch_deg: float = number(0.0, 80.0, 30.0)
    """Steepest climb and descent."""
    step_s: float = number(0.1, 10.0, 1.0)
    """From one command to the next."""
    speed_m_s: float = number(0.01, 3.0, 0.5)  # Constant speed over the ground.
    altitude_m: tuple[float, float] = number(0.1, 20.0)
    """Over the bottom, lowest and highest: the band that a policy is asked to stay in."""
    view_range_m: float = number(0.2, 10.0, 2.0)
    """An oyster is seen when it is no farther from the camera than this, ..."""
    view_lengths: float = number(0.5, 10.0, 3.0)
    """... nor than so many attenuation lengths of the water, ..."""
    view_px: int = number(1, 10_000, 20)
    """... and has at least so many pixels in the picture."""
    hull_m: float = number(0.05, 1.0, 0.2)
    """Radius of the ball that must touch nothing."""
    fence_m: float = number(0.0, 10.0, 1.0)
    """How far inside the edge of the reef the area of a rollout ends: there the vehicle is turned back like a ball."""
    rollout_s: float = number(1.0, 3600.0, 120.0)
    """Length of a rollout."""


def check_steering(task: SteeringRecipe, where: str) -> None:
    """What no single key can say."""
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
