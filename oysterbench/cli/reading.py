"""Options of a command that decide how files of poses are read."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from oysterbench.core.trajectory import ReadOptions

FORMATS = ("tum", "euroc", "kitti", "csv", "npz", "mcap", "bag")
TIME_UNITS = ("s", "ms", "us", "ns")
OF_BOTH: dict[str, tuple[Any, str]] = {
    "format": (click.Choice(FORMATS), "Format.  [default: by the content]"),
    "topic": (str, "Topic of an MCAP file or bag; /tf:map.base_link for one transform."),
    "time-unit": (click.Choice(TIME_UNITS), "Unit of the stamps."),
    "quaternion": (click.Choice(("xyzw", "wxyz")), "Order of the quaternion."),
    "unit": (click.Choice(("m", "mm")), "Unit of the positions."),
}
"""Options of the estimate, and with `truth-` before their names of the truth."""

NUMBERS = {7: "x,y,z,qx,qy,qz,qw", 16: "a 4 x 4 matrix"}


@dataclass(frozen=True)
class Reading:
    """The options as they were given, by their names."""

    values: Mapping[str, Any]

    @property
    def given(self) -> list[str]:
        """Names of the options that were given."""
        return [f"--{name}" for name, value in self.values.items() if value not in (None, False)]

    def options(self) -> tuple[ReadOptions, ReadOptions]:
        """For the truth and for the estimate."""
        from oysterbench.core.trajectory import ReadOptions, read_times

        values = self.values
        times = values["times"] and read_times(values["times"])
        truth = {key.replace("-", "_"): values[f"truth-{key}"] for key in OF_BOTH}
        estimate = {key.replace("-", "_"): values[key] for key in OF_BOTH}
        place = values["T-body-estimate"]
        return (
            ReadOptions(**truth, times=times),
            ReadOptions(
                **estimate,
                times=times,
                frame=values["frame"],
                T_body_estimate=None if place is None else _matrix(place),
                sort=values["sort"],
            ),
        )


def reading_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options, and the argument `reading`."""
    kinds: dict[str, tuple[dict[str, Any], str]] = {}
    for prefix, whose in (("", "Estimate"), ("truth-", "Truth")):
        kinds |= {f"{prefix}{name}": ({"type": kind}, f"{whose}: {text}") for name, (kind, text) in OF_BOTH.items()}
    kinds["times"] = (
        {"type": click.Path(path_type=Path, dir_okay=False)},
        "KITTI: a file with one time a line.  [default: the truth's]",
    )
    kinds["frame"] = ({"type": click.Choice(("body", "optical"))}, "Estimate: whose poses they are.")
    kinds["T-body-estimate"] = (
        {"metavar": "NUMBERS|FILE"},
        "Estimate: where the frame of its poses is in the body: x,y,z,qx,qy,qz,qw or a 4 x 4 matrix.",
    )
    kinds["sort"] = ({"is_flag": True}, "Estimate: put its poses in the order of their stamps.")
    # The command's other options may have the same names: these go by names of their own until they are collected.
    names = {name: f"reading_{name.replace('-', '_').lower()}" for name in kinds}

    @functools.wraps(command)
    def wrapped(**values: Any) -> Any:
        return command(reading=Reading({name: values.pop(own) for name, own in names.items()}), **values)

    for name, (settings, text) in reversed(kinds.items()):
        wrapped = click.option(f"--{name}", names[name], help=text, **settings)(wrapped)
    return wrapped


def _matrix(text: str) -> Any:
    """(4, 4) from 7 or 16 numbers, or from a file that holds them."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    from oysterbench.core.geometry import transform

    source = Path(text).read_text(encoding="utf-8", errors="replace") if Path(text).is_file() else text
    try:
        numbers = np.array(source.replace(",", " ").split(), dtype=float)
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) == 16:
        return numbers.reshape(4, 4)
    if len(numbers) == 7 and np.isfinite(numbers).all() and abs(np.linalg.norm(numbers[3:]) - 1) < 2e-3:
        return transform(Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3])
    raise click.UsageError(
        f"--T-body-estimate: expected {' or '.join(NUMBERS.values())}, or a file with one of them, got {text[:80]!r}"
    )
