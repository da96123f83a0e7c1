"""Commands at labelled pictures, as a table for each sequence: a class of each axis, or how probable each class is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from oysterbench.core.errors import MethodError
from oysterbench.methods.policy import classes_of
from oysterbench.methods.steering import Steering
from oysterbench.recipe.steering import SteeringRecipe
from oysterbench_leaderboard.submissions.archive import shown
from oysterbench_leaderboard.submissions.catalogue import Wanted
from oysterbench_leaderboard.submissions.refusals import Refusal

if TYPE_CHECKING:
    from oysterbench.evaluate.steering import Commands

STAMP = "stamp_ns"
AXES = ("yaw", "pitch")


def read_commands(data: bytes, label: str, sequence: str, wanted: Wanted) -> tuple[Steering, ...]:
    """What is commanded at each picture of a sequence, in the order of the pictures.

    A header and a line for each picture: stamp_ns,yaw,pitch with the numbers of the classes, or
    stamp_ns,yaw_0,...,pitch_0,... with probabilities, which need not add up to 1. Raises Refusal by file and line.
    """
    try:
        lines = data.decode("utf-8-sig").split("\n")
    except UnicodeDecodeError:
        raise Refusal("format", f"{label}: expected a table as text in UTF-8 (CSV)") from None
    task = wanted.task
    assert task is not None, wanted.split  # of a split of the track steering
    numbered = {axis: [f"{axis}_{i}" for i in range(len(getattr(task, f"{axis}_deg")))] for axis in AXES}
    allowed = ([STAMP, *AXES], [STAMP, *numbered["yaw"], *numbered["pitch"]])
    head = [key.strip() for key in lines[0].split(",")]
    if head not in allowed:
        both = f"{','.join(allowed[0])} or {STAMP},yaw_0,...,pitch_0,...,{allowed[1][-1]}"
        raise Refusal("format", f"{label}:1: expected the columns {both}, got {shown(lines[0].strip())}")
    pictures = {name.rpartition("/")[2]: name for name in wanted.images.get(sequence, {})}
    found: dict[int, Steering] = {}
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        where = f"{label}:{number}"
        fields = [field.strip() for field in line.split(",")]
        if len(fields) != len(head):
            raise Refusal("format", f"{where}: expected {len(head)} values, got {len(fields)}")
        stamp = _whole(fields[0], where, STAMP)
        if pictures and str(stamp) not in pictures:
            first = next(iter(pictures))
            raise Refusal("format", f"{where}: no picture of {sequence} has the stamp {stamp}; its first is {first}")
        if stamp in found:
            raise Refusal("format", f"{where}: the picture {stamp} has two commands")
        command = _command(pictures.get(str(stamp), f"{sequence}/{stamp}"), fields[1:], len(numbered["yaw"]), where)
        try:
            classes_of(command, task, where)
        except MethodError as error:
            raise Refusal("format", str(error)) from None
        found[stamp] = command
    if missing := [stamp for stamp in pictures if int(stamp) not in found]:
        raise Refusal(
            "format",
            f"{label}: {len(missing)} of {len(pictures)} pictures have no command, the first being {missing[0]}; "
            "expected all of a sequence, or none",
        )
    return tuple(found[stamp] for stamp in sorted(found))


def steering_commands(given: Sequence[Steering], task: SteeringRecipe) -> Commands:
    """The commands of a sequence, as the evaluator takes them."""
    import numpy as np

    from oysterbench.evaluate.steering import Commands
    from oysterbench.methods.policy import probabilities

    chosen = [classes_of(one, task, one.name) for one in given]
    shares = [probabilities(one, classes, task) for one, classes in zip(given, chosen, strict=True)]
    yaw, pitch = (np.array(of) for of in zip(*shares, strict=True))
    return Commands(np.array(chosen, dtype=np.int64), yaw, pitch)


def _command(name: str, values: Sequence[str], yaws: int, where: str) -> Steering:
    """A line, as a method would have given it."""
    import numpy as np

    if len(values) == len(AXES):
        return Steering(name, yaw=_whole(values[0], where, "yaw"), pitch=_whole(values[1], where, "pitch"))
    shares = np.array([_share(value, where) for value in values])
    return Steering(name, yaw_probability=shares[:yaws], pitch_probability=shares[yaws:])


def _whole(text: str, where: str, key: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 20):
        raise Refusal("format", f"{where}: {key}: expected a whole number from 0, got {shown(text)}")
    return int(text)


def _share(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in text:
        raise Refusal("format", f"{where}: expected a probability, got {shown(text)}")
    return value
