"""Writes the configuration of a published system for one sequence, and prints the command line of its program.

    python -m oysterbench.methods.systems.launch REFERENCE BUILD INPUT FOLDER NUMBER

The module `configure` in the system's folder has a function `command`, which receives a `Launch`, writes what the
program reads into `Launch.folder`, and returns the command line, which becomes the last line of the output, as JSON.
It is a process of its own that ends before the program starts: the peak memory of a process outlasts `exec`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from oysterbench.core.errors import MethodError, OysterbenchError
from oysterbench.core.geometry import invert
from oysterbench.methods.interfaces import interface_of
from oysterbench.methods.systems.manifest import SystemMethod, split_reference
from oysterbench.sequence import CameraCalibration, Sequence, open_sequence

CONFIGURATION = "configuration"
MOST_ANGLE_DEG = 45.0
"""Between the axes of two cameras that are a stereo pair: beyond it they share little of what they see."""
LEAST_BASELINE_M = 0.01
"""Between two cameras that are a stereo pair: they measure no depth from closer together."""


@dataclass(frozen=True)
class Launch:
    """One run of a system.

    method, about: the method's name and its entry in the manifest; options: all options of the system, by key; given:
    the sequence in the method's form, without the ground truth; source, build: the edited source tree and the build
    folder; folder: where the configuration goes; out: where the output for its track goes; number: of the run, from 0
    """

    method: str
    about: SystemMethod
    options: Mapping[str, Any]
    given: Path
    source: Path
    build: Path
    folder: Path
    out: Path
    number: int

    @cached_property
    def sequence(self) -> Sequence:
        """The input as a sequence (track slam only), above all for its calibration."""
        return open_sequence(self.given)

    @cached_property
    def cameras(self) -> dict[str, CameraCalibration]:
        """The first two cameras of the sequence if the method uses a stereo pair, else its first one, by name.

        Raises MethodError where the sequence has fewer, as a stereo system with one camera would be another method,
        and where two do not look at the same thing from apart.
        """
        return cameras_of(self.method, self.about, self.sequence)


def cameras_of(method: str, about: SystemMethod, sequence: Sequence) -> dict[str, CameraCalibration]:
    """The cameras of a sequence that a method uses, by name (see `Launch.cameras`). Raises MethodError where there are
    fewer, or where two are no stereo pair."""
    wanted = 2 if "stereo" in about.sensors else int("mono" in about.sensors)
    found = dict(list(sequence.cameras.items())[:wanted])
    if len(found) < wanted:
        raise MethodError(
            f"{method}: expected a sequence with {wanted} camera{'s' if wanted > 1 else ''}, got "
            f"{sequence.name} with {', '.join(found) or 'none'}; 'oysterbench systems' lists sensors"
        )
    if wanted > 1:
        _check_pair(method, sequence.name, found)
    return found


def _check_pair(method: str, sequence: str, cameras: Mapping[str, CameraCalibration]) -> None:
    """Raise MethodError where two cameras cannot see the same thing from two places."""
    first, second = cameras.values()
    T_first_second = invert(first.T_base_cam) @ second.T_base_cam
    angle = float(np.degrees(np.arccos(np.clip(T_first_second[2, 2], -1, 1))))
    base = float(np.linalg.norm(T_first_second[:3, 3]))
    if angle > MOST_ANGLE_DEG or base < LEAST_BASELINE_M:
        raise MethodError(
            f"{method}: expected a stereo pair as the first two cameras, with axes at most {MOST_ANGLE_DEG:g} deg and "
            f"centres at least {100 * LEAST_BASELINE_M:g} cm apart, got {sequence} with {' and '.join(cameras)}, "
            f"{angle:.0f} deg and {100 * base:.1f} cm apart; run a method for one camera"
        )


def launch_of(reference: str, place: Path, given: Path, folder: Path, number: int) -> tuple[Launch, list[str]]:
    """Prepare a run. Returns it and the command line of its program."""
    found = split_reference(reference)
    if found is None:
        raise MethodError(f"no published system has a method {reference!r}")
    system, name, options = found
    method = name.partition("[")[0]
    about = system.description.methods[method]
    kept = folder / CONFIGURATION
    kept.mkdir(parents=True, exist_ok=True)
    launch = Launch(
        method=method,
        about=about,
        options=options,
        given=given.absolute(),
        source=place / "source",
        build=place / "build",
        folder=kept.absolute(),
        out=(folder / interface_of(about.track).out).absolute(),
        number=number,
    )
    command: list[str] = import_module(f"{system.module}.configure").command(launch)
    return launch, command


def main(reference: str, place: str, given: str, folder: str, number: str) -> None:
    """Prepare a run with the arguments of the command line."""
    try:
        _, command = launch_of(reference, Path(place), Path(given), Path(folder), int(number))
    except OysterbenchError as error:
        sys.exit(str(error))
    print(json.dumps([*map(str, command)]))


def printed_command(stdout: Path) -> list[str]:
    """Read the command line that a launch printed. Raises MethodError where there is none."""
    try:
        command: list[str] = json.loads(stdout.read_text(encoding="utf-8").splitlines()[-1])
    except (OSError, ValueError, IndexError):
        raise MethodError("its configure.py ended before it returned a command line") from None
    return command


if __name__ == "__main__":
    main(*sys.argv[1:])
