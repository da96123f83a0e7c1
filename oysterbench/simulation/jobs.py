"""The independent jobs that make a sequence: frames, pings, and all small sensors together."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from oysterbench.core.ros import TF_STATIC
from oysterbench.recipe import RigRecipe, SequenceRecipe, SplitRecipe, count
from oysterbench.recipe.sensors import SensorRecipe
from oysterbench.sensors.registry import kind_of, rig_sensors
from oysterbench.sequence.cut import match_topics
from oysterbench.sequence.truth import rig_topics


@dataclass(frozen=True)
class Job:
    """A job: a frame or ping of the camera or sonar named `source`, or all small sensors where that is empty."""

    sequence: str
    source: str = ""
    frame: int = 0

    @property
    def part(self) -> str:
        """Name of the part file that holds its bytes."""
        return f"{self.source}-{self.frame:06d}.part" if self.source else "sensors.part"

    @property
    def frames(self) -> int:
        """Number of frames that it makes, for progress."""
        return 1 if self.source else 0


def plan(
    split: SplitRecipe, sequence: SequenceRecipe, topics: Collection[str] = (), taken: Collection[str] = ()
) -> list[Job]:
    """All jobs of a sequence, or those needed for some topics, by patterns such as `/imu` or `/cam_front/*`; taken:
    topics that need none."""
    jobs = [Job(sequence.name)]
    for source, recipe in wanted_sensors(split, sequence, topics, taken).items():
        jobs += [Job(sequence.name, source, frame) for frame in range(count(sequence.duration_s, recipe.rate_hz))]
    return jobs


def bulky_sensors(rig: RigRecipe) -> dict[str, SensorRecipe]:
    """Name -> recipe of the sensors whose measurements are jobs of their own."""
    return {kind.name_of(recipe): recipe for kind, recipe in rig_sensors(rig) if kind.bulky}


def wanted_topics(split: SplitRecipe, sequence: SequenceRecipe, topics: Collection[str] = ()) -> dict[str, str]:
    """Topic -> message type of the topics that match the patterns (all without patterns), in the order of the file.

    Raises SequenceError where a pattern matches no topic.
    """
    known = rig_topics(split.rig_of(sequence))
    return {topic: known[topic] for topic in match_topics(known, topics, sequence.name)} if topics else known


def wanted_sensors(
    split: SplitRecipe, sequence: SequenceRecipe, topics: Collection[str] = (), taken: Collection[str] = ()
) -> dict[str, SensorRecipe]:
    """Those of `bulky_sensors` whose jobs make topics that match the patterns and are not taken from elsewhere."""
    rig = split.rig_of(sequence)
    made_by = sources(rig)
    needed = {made_by.get(topic) for topic in wanted_topics(split, sequence, topics) if topic not in taken}
    return {name: recipe for name, recipe in bulky_sensors(rig).items() if name in needed}


def sources(rig: RigRecipe) -> dict[str, str]:
    """Topic -> source of the jobs whose parts contain it, in the order of the file; all topics but `/tf_static`."""
    bulky = {topic: name for name, recipe in bulky_sensors(rig).items() for topic in kind_of(recipe).topics(recipe)}
    return {name: bulky.get(name, "") for name in rig_topics(rig) if name != TF_STATIC}
