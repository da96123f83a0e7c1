"""Running a policy: views in, commands out, one at a time and checked."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from oysterbench.core.errors import MethodError, OysterbenchError
from oysterbench.core.geometry import Array
from oysterbench.methods.steering import Steering, SteeringMethod, View
from oysterbench.recipe import SteeringRecipe

AXES = ("yaw", "pitch")


class _Views:
    def __init__(self, task: SteeringRecipe, views: Iterator[View]) -> None:
        self.task = task
        self._views = views

    def __iter__(self) -> Iterator[View]:
        return self._views


def commands(
    policy: SteeringMethod, task: SteeringRecipe, views: Iterator[View], where: str
) -> Iterator[tuple[View, Steering, tuple[int, int]]]:
    """Yield each view, the policy's command for it, and the classes of yaw and pitch that the command means.

    Raises MethodError where the policy fails, names another view, or requests a view before it has given a command for
    the last one.
    """
    last: list[View] = []

    def remembered() -> Iterator[View]:
        for view in views:
            last[:] = [view]
            yield view
            if last:
                raise MethodError(
                    f"method {policy.name!r}, {where}: requested another view before giving a command at {view.name}"
                )

    try:
        for command in policy.run(_Views(task, remembered())):
            if not last or not isinstance(command, Steering) or command.name != last[0].name:
                raise MethodError(
                    f"method {policy.name!r}, {where}: expected a Steering of the view "
                    f"{last[0].name if last else '(none was taken)'}, got {command!r:.80}"
                )
            view = last.pop()
            yield view, command, classes_of(command, task, f"method {policy.name!r}, {where}, view {view.name}")
    except OysterbenchError:
        raise
    except Exception as error:
        line = " ".join(f"{type(error).__name__}: {error}".split())
        raise MethodError(f"method {policy.name!r} failed, {where}: {line}") from error


def classes_of(command: Steering, task: SteeringRecipe, where: str) -> tuple[int, int]:
    """Classes of yaw and pitch that a command names or gives the highest probability; ties go to the straightest.

    Raises MethodError where both are given and contradict each other, or one of them is not as expected.
    """
    found = []
    for axis, degrees in (("yaw", task.yaw_deg), ("pitch", task.pitch_deg)):
        number, shares = getattr(command, axis), getattr(command, f"{axis}_probability")
        if shares is not None:
            shares = np.asarray(shares, dtype=float)
            if (
                shares.shape != (len(degrees),)
                or not np.isfinite(shares).all()
                or (shares < 0).any()
                or not shares.any()
            ):
                raise MethodError(
                    f"{where}: {axis}_probability: expected {len(degrees)} numbers, none below 0 and not all 0, got "
                    f"{np.round(shares, 3).tolist()!s:.80}"
                )
            near = -np.abs(np.arange(len(degrees)) - degrees.index(0.0))
            most = int(np.lexsort((near, shares))[-1])
            number = _agreed(number, shares, most, f"{where}: {axis}")
        if isinstance(number, bool) or not isinstance(number, int | np.integer) or not 0 <= number < len(degrees):
            raise MethodError(f"{where}: {axis}: expected a class from 0 to {len(degrees) - 1}, got {number!r}")
        found.append(int(number))
    return found[0], found[1]


def _agreed(number: Any, shares: Array, most: int, where: str) -> Any:
    """The class that a command names beside probabilities, which must be a most probable one, or that one."""
    if number is None:
        return most
    if number not in np.flatnonzero(shares == shares.max()):
        raise MethodError(f"{where}: expected a class or probabilities, got {number!r} and, as most probable, {most}")
    return number


def probabilities(command: Steering, classes: tuple[int, int], task: SteeringRecipe) -> tuple[Array, Array]:
    """Probabilities of the classes of yaw (Y,) and pitch (P,), each adding up to 1, of a command that was checked."""
    found = []
    for axis, chosen, degrees in zip(AXES, classes, (task.yaw_deg, task.pitch_deg), strict=True):
        given = getattr(command, f"{axis}_probability")
        if given is None:
            found.append(np.eye(len(degrees))[chosen])
        else:
            scaled = np.asarray(given, dtype=float) / np.max(given)  # the sum of very large numbers would overflow
            found.append(scaled / scaled.sum())
    return found[0], found[1]
