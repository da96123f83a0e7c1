"""The page of all topics of a sequence file and their readers, from the sensor kinds and the ground-truth topics."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

from docs.generate.markdown import code, table

HEAD = """# Topics

A sequence is one MCAP file of ROS 2 messages. `NAME` is the name of a sensor on its rig, such as `cam_left`; topics of
sensors that the rig lacks are absent. Topics marked as ground truth are never given to methods.

"""


@dataclass(frozen=True)
class Topic:
    """A topic of a file: its name, with NAME for that of the sensor, its ROS type, the sensor that it belongs to, how
    `Sequence` reads it, and whether it is ground truth."""

    name: str
    type: str
    sensor: str
    reader: str
    truth: bool


def all_topics() -> Iterator[Topic]:
    """Iterate over all topics that a sequence file may have."""
    from oysterbench.core.ros import TF_STATIC
    from oysterbench.sensors.kind import topic
    from oysterbench.sensors.registry import sensor_kinds
    from oysterbench.sequence.truth import TRANSFORMS, TRUTH_TYPES

    for block, kind in sensor_kinds().items():
        name = block if kind.single else "NAME"
        reader = f"{kind.reader}({'' if kind.single else 'NAME'})" if kind.reader else "measurements(NAME)"
        for leaf, type_ in kind.leaves.items():
            yield Topic(topic(name, leaf), type_, kind.title, reader, False)
        for leaf, type_ in kind.truth_leaves.items():
            reads = "clouds(NAME)" if leaf == "cloud" else f'layer(NAME, "{leaf}")'
            yield Topic(topic(name, leaf), type_, kind.title, reads, True)
    for name, type_ in TRUTH_TYPES.items():
        yield Topic(name, type_, "vehicle", "truth()", True)
    yield Topic(TF_STATIC, TRANSFORMS, "vehicle", "T_base_NAME of a calibration", False)


def topics_page() -> str:
    """The page of all topics."""
    rows = [
        (code(each.name), each.sensor, code(each.type), code(each.reader), "ground truth" if each.truth else "")
        for each in all_topics()
    ]
    return HEAD + table(("Topic", "Sensor", "Type", "Reader of `Sequence`", ""), rows) + _messages()


def _messages() -> str:
    """Paragraph on the types of the measurements that readers return."""
    from oysterbench.core import measurements

    kinds = [
        kind
        for kind in vars(measurements).values()
        if dataclasses.is_dataclass(kind) and isinstance(kind, type) and kind.__module__ == measurements.__name__
    ]
    names = ", ".join(f"[`{kind.__name__}`][oysterbench.core.measurements.{kind.__name__}]" for kind in kinds)
    return f"\nWhat the readers give: {names}. Shapes and units are there.\n"
