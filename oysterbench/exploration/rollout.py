"""Closed-loop rollout: a policy commands, the vehicle moves, and its next view is rendered."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import MethodError, RecipeError
from oysterbench.core.geometry import Array, transform
from oysterbench.core.streams import Streams
from oysterbench.evaluate.steering import RolloutLog
from oysterbench.exploration.references import reference
from oysterbench.methods.policy import commands
from oysterbench.methods.steering import SteeringMethod, View
from oysterbench.recipe import SplitRecipe
from oysterbench.scene.path.disturbance import sway
from oysterbench.simulation.simulated_sequence import build_sequence
from oysterbench.simulation.steering.expert import Expert, best
from oysterbench.simulation.steering.observation import Observation
from oysterbench.simulation.steering.site import Site, build_site, measure_state
from oysterbench.simulation.steering.vehicle import advance, folded, rotations, turns

START_SHARE = 0.7  # share of the area's half side within which rollouts start
CEILING_M = 0.3  # minimum depth of the vehicle below the surface

Progress = Callable[[int, int], None]
"""Called with the number of commands done and the total."""

TrainingExample = tuple[View, Array]
"""A view and the action values there, from `Expert.values`."""


def explore(
    split: SplitRecipe,
    reef: str,
    policy: str | SteeringMethod,
    *,
    salt: bytes = b"",
    seconds: float | None = None,
    start: int = 0,
    device: str = "cpu",
    progress: Progress | None = None,
    teacher: bool = False,
    mixture: float = 0.0,
) -> tuple[RolloutLog, list[TrainingExample]]:
    """Run a policy (one of REFERENCES, or a method) over the reef of a sequence; return the log and the examples.

    seconds: length of the rollout, if not the task's. start: number of the start pose, the same for every policy.
    teacher: whether to return the expert's action values at each view as examples. mixture: share of the commands that
    are the expert's instead of the policy's, as in the first rounds of DAgger (Ross, Gordon & Bagnell 2011).

    Raises RecipeError where the split has no table [steering] or no such sequence, MethodError where the policy fails.
    """
    if split.steering is None:
        raise RecipeError(f"split {split.name} has no table [steering]; expected one of the track steering")
    seconds = split.steering.rollout_s if seconds is None else seconds
    steps = round(seconds / split.steering.step_s)
    if steps < 1:
        raise RecipeError(f"seconds: expected at least a step of {split.steering.step_s:g} s, got {seconds:g}")
    simulated = build_sequence(split, reef, salt, device)
    site = build_site(simulated, split.steering)
    streams = simulated.streams.at("steering", start)
    pictures = not isinstance(policy, str)
    rollout = Rollout(site, reef, steps, streams, progress or (lambda done, total: None), pictures)
    examples: list[TrainingExample] = []
    if isinstance(policy, str):
        command = reference(policy, site, rollout.state, rollout.streams)
        for _ in range(steps):
            rollout.do(command(rollout.state, rollout.observation.found))
        return rollout.log(policy), examples
    expert = Expert(site) if teacher or mixture > 0 else None
    draws = rollout.streams.generator("mixture").random(steps)
    for view, _, (yaw, pitch) in commands(policy, split.steering, rollout.views(), f"{reef}: rollout"):
        if expert is not None:
            values = expert.values(rollout.state, rollout.observation.found)
            examples.append((view, values))
            if draws[rollout.done] < mixture:
                yaw, pitch = best(values)
        rollout.do((yaw, pitch))
    if rollout.done < steps:
        raise MethodError(f"method {policy.name!r}, {reef}: expected {steps} commands, got {rollout.done}")
    return rollout.log(policy.name), examples


@dataclass
class Rollout:
    """A rollout in progress. pictures: whether the policy needs images; state (5,): as in `vehicle`; done: number of
    commands carried out."""

    site: Site
    reef: str
    steps: int
    streams: Streams
    progress: Progress
    pictures: bool
    state: Array = field(init=False)
    done: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._began = time.perf_counter(), time.process_time()
        task, plan = self.site.task, self.site.simulated.recipe.path
        self._turns = turns(task)
        times = np.arange(self.steps + 1) * task.step_s
        # As if the vehicle had been moving for long: the sway has grown to its full amplitude.
        self._sway = sway(np.asarray(times + plan.ramp_s, dtype=float), np.ones((len(times), 1)), plan, self.streams)
        self.observation = Observation(self.site)
        self.state = self._begin()
        self._states = [self.state]
        self._commands: list[tuple[int, int]] = []
        self._contact, self._turned = [False], [False]
        self._seen: list[int] = []
        self._covered: list[float] = []
        self._picture = np.empty((0, 0, 3), dtype=np.uint8)
        self._render_view()

    def _begin(self) -> Array:
        """Draw the start state (5,): in the inner area, any heading, in the middle of the altitude band, level."""
        generator = self.streams.generator("start")
        x, y = (2 * generator.random(2) - 1) * START_SHARE * self.site.half_m
        heading = float(generator.uniform(-np.pi, np.pi))
        bottom = float(self.site.world.ground_height(x, y))
        floor = float(self.site.floor(np.array([x]), np.array([y]))[0])
        return np.array([x, y, max(bottom + 0.5 * sum(self.site.task.altitude_m), floor), heading, 0.0])

    def body(self) -> Array:
        """Current pose T_map_base (4, 4), including the vehicle's sway."""
        moved = self._sway[self.done]
        position = self.state[:3] + moved[:3]
        return transform(rotations(self.state[None])[0] @ Rotation.from_euler("ZYX", moved[3:]).as_matrix(), position)

    def _render_view(self) -> None:
        """Render the current view; only the ground truth for policies that need no images."""
        body, time_s = self.body(), self.done * self.site.task.step_s
        T_map_cam = body @ self.site.mount
        renderer = self.site.simulated.renderers[self.site.camera.name]
        if self.pictures:
            noise = self.streams.generator("noise", self.done)
            frame = renderer.render(T_map_cam, noise, time_s, body)
            self._picture, depth, instances = frame.colour, frame.depth, frame.instances
        else:
            depth, _, instances = renderer.truth(T_map_cam, time_s)
        self._seen.append(self.observation.observe(T_map_cam, depth, instances))
        self._covered.append(self.observation.covered)

    def view(self) -> View:
        """Current input of the policy: the picture from the vehicle as it sways, its state without the sway."""
        time_s = self.done * self.site.task.step_s
        return View(f"{self.done:06d}", self._picture, measure_state(self.site, self.state), time_s)

    def views(self) -> Iterator[View]:
        """Iterate over the views, one before each command; the next once the command has been carried out."""
        while self.done < self.steps:
            yield self.view()

    def do(self, command: tuple[int, int]) -> None:
        """Carry a command out."""
        task = self.site.task
        path = advance(self.state[None], self._turns[0][[command[0]]], self._turns[1][[command[1]]], task)[0]
        path, turned = folded(path, self.site.half_m)
        # Where the vehicle would touch, it is held above the bottom, as by a pilot assistance; the path goes on there.
        lifted, contact = 0.0, False
        for point in path:
            floor = float(self.site.floor(point[:1], point[1:2])[0])
            point[2] += lifted
            if point[2] < floor:
                contact = True
                lifted += floor - point[2]
                point[2] = floor
            if point[2] > -CEILING_M:
                lifted -= point[2] + CEILING_M
                point[2] = -CEILING_M
        self.state = path[-1]
        self.done += 1
        self._states.append(self.state)
        self._commands.append((int(command[0]), int(command[1])))
        self._contact.append(contact)
        self._turned.append(bool(turned.any()))
        self._render_view()
        self.progress(self.done, self.steps)

    def log(self, policy: str) -> RolloutLog:
        """The rollout so far."""
        states = np.array(self._states)
        wall, cpu = (
            now - then for now, then in zip((time.perf_counter(), time.process_time()), self._began, strict=True)
        )
        return RolloutLog(
            reef=self.reef,
            policy=policy,
            step_s=self.site.task.step_s,
            states=states,
            altitude=self.site.altitude(states),
            commands=np.array(self._commands, dtype=np.int64).reshape(-1, 2),
            seen=np.array(self._seen, dtype=np.int64),
            contact=np.array(self._contact),
            turned=np.array(self._turned),
            covered=np.array(self._covered),
            half_m=self.site.half_m,
            oysters=self.site.oysters,
            found=self.observation.found.copy(),
            wall_s=wall,
            cpu_s=cpu,
        )
