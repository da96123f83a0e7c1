"""Policies on labelled images: views in, a command for each out.

The input folder of a program holds STAMP.png for each view, views.csv (a line for each view: stamp_ns, time_s,
heading_rad, pitch_rad, depth_m, altitude_m and view, its name) and task.json, the table [steering]. The program writes
a table (CSV) with a line for each view: stamp_ns,yaw,pitch with class numbers, or stamp_ns,yaw_0,...,pitch_0,... with
the probability of each class.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array
from oysterbench.methods.images import Picture
from oysterbench.methods.interfaces.images import FORM, read_picture, write_pictures
from oysterbench.methods.interfaces.interface import Interface, Predicted, RunSequence, Stopwatch
from oysterbench.methods.policy import AXES, classes_of, commands, probabilities
from oysterbench.methods.steering import Steering, VehicleState, View
from oysterbench.recipe import SteeringRecipe

VIEWS, TASK, COMMANDS = "views.csv", "task.json", "commands.npz"
STAMP = "stamp_ns"
SHOWN = 80
"""Maximum number of characters of foreign text quoted in a message."""

COLUMNS = (STAMP, "time_s", "heading_rad", "pitch_rad", "depth_m", "altitude_m", "view")


class SteeringInterface(Interface):
    """Views in, a `Steering` for each out."""

    forms: ClassVar = {FORM: "a folder of images, STAMP.png, with views.csv and task.json"}
    own_form = FORM
    lasting = (FORM,)
    out = "commands.csv"
    leaves = "a table of commands"

    def predict(self, method: Any, given: Path, folder: Path, watch: Stopwatch) -> Predicted:
        """Run the method on the views, which it receives one by one."""
        task, rows = read_task(given), _rows(given)
        views = (_view(given, row) for row in rows)
        with watch:
            made = [command for _, command, _ in commands(method, task, watch.leave_out(views), given.name)]
        if len(made) < len(rows):
            raise MethodError(
                f"method {method.name!r} on {given.name}: expected {len(rows)} commands, one for each view, got "
                f"{len(made)}"
            )
        _write(folder, task, made)
        return Predicted()

    def take(
        self, sequence: RunSequence, given: Path, folder: Path, form: str, options: Mapping[str, str]
    ) -> Predicted:
        """Read the table of commands that a program left."""
        task = read_task(given)
        _write(folder, task, read_commands(folder / self.out, [int(row[0]) for row in _rows(given)], task))
        return Predicted()


def write_views(views: Iterable[View], task: SteeringRecipe, folder: Path) -> None:
    """Write the input folder of a policy. The name of each view must end with its stamp."""
    rows: list[tuple[Any, ...]] = [COLUMNS]

    def pictures() -> Iterator[Picture]:
        for view in views:
            stamp = view.name.rpartition("/")[2]
            rows.append((stamp, view.time_s, *astuple(view.state), view.name))
            yield Picture(stamp, view.pixels)

    write_pictures(pictures(), folder)
    with open(folder / VIEWS, "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
    (folder / TASK).write_text(json.dumps(asdict(task)), encoding="utf-8")


def read_task(folder: Path) -> SteeringRecipe:
    """Read the task of a folder of views."""
    return task_of(json.loads((folder / TASK).read_text(encoding="utf-8")))


def task_of(values: Mapping[str, Any]) -> SteeringRecipe:
    """Build a table [steering] from plain values."""
    given: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
    return SteeringRecipe(**given)


def read_commands(path: Path, stamps: Sequence[int], task: SteeringRecipe) -> list[Steering]:
    """Read the commands for the views of these stamps (`parse_commands`). Raises MethodError with file and line."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MethodError(f"{path.name}: expected a table as text in UTF-8 (CSV): {error}") from None
    return parse_commands(data, path.name, task, stamps)


def parse_commands(data: bytes, label: str, task: SteeringRecipe, stamps: Sequence[int] = ()) -> list[Steering]:
    """Parse a table of commands: one for each of these stamps, in their order, or, if no stamps are given, all commands
    of the table, sorted by stamp. Probabilities need not add up to 1. Raises MethodError with line and `label`, the
    name of the file."""
    try:
        lines = list(csv.reader(io.StringIO(data.decode("utf-8-sig"), newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise MethodError(f"{label}: expected a table as text in UTF-8 (CSV): {error}") from None
    numbered = {axis: [f"{axis}_{i}" for i in range(len(getattr(task, f"{axis}_deg")))] for axis in AXES}
    allowed = ([STAMP, *AXES], [STAMP, *numbered["yaw"], *numbered["pitch"]])
    head = [key.strip() for key in lines[0]] if lines else []
    if head not in allowed:
        both = f"{','.join(allowed[0])} or {STAMP},yaw_0,...,pitch_0,...,{allowed[1][-1]}"
        raise MethodError(f"{label}:1: expected the columns {both}, got {','.join(head)[:SHOWN]!a}")
    wanted, found = set(stamps), dict[int, Steering]()
    for number, line in enumerate(lines[1:], start=2):
        where, fields = f"{label}:{number}", [field.strip() for field in line]
        if fields in ([], [""]):
            continue
        if len(fields) != len(head):
            raise MethodError(f"{where}: expected {len(head)} values, got {len(fields)}")
        stamp = _whole(fields[0], where, STAMP)
        if wanted and stamp not in wanted:
            raise MethodError(f"{where}: no image has the stamp {stamp}; the first is {stamps[0]}")
        if stamp in found:
            raise MethodError(f"{where}: the image {stamp} has two commands")
        if head == allowed[0]:
            command = Steering(fields[0], _whole(fields[1], where, "yaw"), _whole(fields[2], where, "pitch"))
        else:
            shares = np.array([_share(value, where) for value in fields[1:]])
            yaw, pitch = np.split(shares, [len(numbered["yaw"])])
            command = Steering(fields[0], yaw_probability=yaw, pitch_probability=pitch)
        classes_of(command, task, where)
        found[stamp] = command
    if missing := [stamp for stamp in stamps if stamp not in found]:
        raise MethodError(
            f"{label}: {len(missing)} of {len(stamps)} images have no command, the first being {missing[0]}"
        )
    return [found[stamp] for stamp in stamps or sorted(found)]


def _whole(text: str, where: str, key: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 20):
        raise MethodError(f"{where}: {key}: expected a whole number from 0, got {text[:SHOWN]!a}")
    return int(text)


def _share(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in text:
        raise MethodError(f"{where}: expected a probability, got {text[:SHOWN]!a}")
    return value


def command_arrays(made: Sequence[Steering], task: SteeringRecipe) -> tuple[NDArray[np.int64], Array, Array]:
    """Classes (N, 2), yaw probabilities (N, Y) and pitch probabilities (N, P) of N commands."""
    chosen = [classes_of(one, task, one.name) for one in made]
    both = [probabilities(one, classes, task) for one, classes in zip(made, chosen, strict=True)]
    yaw, pitch = (np.array([pair[k] for pair in both]).reshape(len(made), -1) for k in (0, 1))
    return np.array(chosen, dtype=np.int64).reshape(-1, 2), yaw, pitch


def read_classes(folder: Path, task: SteeringRecipe) -> tuple[NDArray[np.int64], Array, Array]:
    """Read the commands that a run left: classes (N, 2) int64, yaw probabilities (N, Y), pitch probabilities (N, P).

    Raises MethodError where they are not commands of the task.
    """
    try:
        with np.load(folder / COMMANDS, allow_pickle=False) as held:
            classes, *shares = held["classes"], held["yaw"], held["pitch"]
        counts = (len(task.yaw_deg), len(task.pitch_deg))
        fits = classes.dtype == np.int64 and classes.shape == (len(classes), 2)
        fits = fits and bool((classes >= 0).all() and (classes < counts).all())
        for each, count in zip(shares, counts, strict=True):
            fits = fits and each.dtype.kind == "f" and each.shape == (len(classes), count)
            fits = fits and bool((each >= 0).all() and np.allclose(each.sum(axis=1), 1.0))
        if not fits:
            raise ValueError("expected classes of the task, and probabilities that add up to 1")
    except Exception as error:  # numpy and zipfile raise many types, and the bytes may come from a stranger
        raise MethodError(f"{folder / COMMANDS}: no commands can be read: {type(error).__name__}: {error}") from None
    return classes, shares[0], shares[1]


def _write(folder: Path, task: SteeringRecipe, made: Sequence[Steering]) -> None:
    classes, yaw, pitch = command_arrays(made, task)
    np.savez_compressed(folder / COMMANDS, classes=classes, yaw=yaw, pitch=pitch)


def _rows(folder: Path) -> list[list[str]]:
    """Rows of views.csv, without the header."""
    with open(folder / VIEWS, newline="", encoding="utf-8") as file:
        return list(csv.reader(file))[1:]


def _view(folder: Path, row: Sequence[str]) -> View:
    stamp, time_s, *state, name = row
    return View(name, read_picture(folder, stamp), VehicleState(*map(float, state)), float(time_s))


INTERFACE = SteeringInterface()
