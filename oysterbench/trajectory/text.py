"""The text formats that trajectories come in."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from oysterbench.errors import TrajectoryError
from oysterbench.files import write_atomically
from oysterbench.trajectory.poses import Trajectory

MAX_SECONDS = 1e11  # a stamp above this is not seconds: it would be 3000 years after the epoch
MIN_NANOSECONDS = 1e17  # a stamp above this is nanoseconds: as microseconds it would be 3000 years after the epoch


def seconds_to_ns(text: str) -> int:
    """Nanoseconds from seconds as text, exact where a float64 would round ("1403636580.838555648").

    Decimals past the ninth are rounded, not cut: numpy writes 0.15 as "1.499999999999999944e-01".
    """
    return _to_integer(text, 9)


def _to_integer(text: str, shift: int) -> int:
    """The decimal number `text` times 10**shift, rounded. Raises ValueError where it is not a finite number."""
    try:
        value = Decimal(text.strip())
    except InvalidOperation:
        raise ValueError(f"not a number: {text!r}") from None
    if not value.is_finite() or value.adjusted() > 30:
        raise ValueError(f"not a time: {text!r}")
    return int(value.scaleb(shift).to_integral_value())


def ns_to_seconds(stamp_ns: int) -> str:
    """Seconds as `%d.%09d`, exact."""
    sign = "-" if stamp_ns < 0 else ""
    whole, nanoseconds = divmod(abs(int(stamp_ns)), 1_000_000_000)
    return f"{sign}{whole}.{nanoseconds:09d}"


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a trajectory file: TUM (`s x y z qx qy qz qw`) or EuRoC (`ns,x,y,z,qw,qx,qy,qz,...`).

    Comments (#), blank lines, one line of column names, tabs and repeated spaces are fine. A line with commas is
    EuRoC. A file with spaces whose stamps can only be nanoseconds is read as such, since ORB-SLAM3 writes that.
    Raises TrajectoryError naming file and line.
    """
    path = Path(path)
    stamps: list[int] = []
    values: list[list[float]] = []
    first: _Line | None = None
    for number, text in enumerate(_read_text(path).split("\n"), start=1):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        where = f"{path}:{number}"
        line = _Line.parse(text, where)
        if first is None:
            if line.is_header():
                continue
            first = line
        elif (line.commas, line.nanoseconds) != (first.commas, first.nanoseconds):
            raise TrajectoryError(
                f"{where}: expected {first.layout()} as on the lines before, got {line.layout()}: {text.strip()[:60]!r}"
            )
        stamp, pose = line.pose()
        stamps.append(stamp)
        values.append(pose)
    if not stamps:
        raise TrajectoryError(f"{path} holds no pose; expected lines of `t x y z qx qy qz qw`")
    table = np.array(values)
    return Trajectory(np.array(stamps, dtype=np.int64), table[:, :3].copy(), table[:, 3:].copy())


def _read_text(path: Path) -> str:
    expected = "expected a trajectory in TUM or EuRoC format"
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise TrajectoryError(f"{path}: no such file; {expected}") from None
    except IsADirectoryError:
        raise TrajectoryError(f"{path} is a folder; {expected}, a file") from None
    except UnicodeDecodeError:
        raise TrajectoryError(f"{path} is not text; {expected}") from None
    except OSError as error:
        raise TrajectoryError(f"{path}: cannot be read: {error.strerror or error}") from None
    if "\0" in text:
        raise TrajectoryError(f"{path} is not text; {expected}")
    return text


@dataclass(frozen=True)
class _Line:
    """One line of a trajectory file, split into fields."""

    fields: list[str]
    commas: bool
    nanoseconds: bool
    where: str

    @classmethod
    def parse(cls, text: str, where: str) -> _Line:
        commas = "," in text
        fields = [field.strip() for field in text.split(",")] if commas else text.split()
        nanoseconds = commas or abs(_float_or_nan(fields[0])) >= MIN_NANOSECONDS
        return cls(fields, commas, nanoseconds, where)

    def is_header(self) -> bool:
        """Whether no field is a number: the names of the columns."""
        return all(math.isnan(_float_or_nan(f)) and f.lower().lstrip("+-") != "nan" for f in self.fields)

    def layout(self) -> str:
        return f"{'commas' if self.commas else 'spaces'} and stamps in {'nanoseconds' if self.nanoseconds else 's'}"

    def pose(self) -> tuple[int, list[float]]:
        """Stamp in ns and x y z qx qy qz qw."""
        shown = repr((", " if self.commas else " ").join(self.fields)[:60])
        # EuRoC's own ground truth goes on with velocity and biases; TUM lines end with the quaternion.
        if len(self.fields) < 8 or (len(self.fields) > 8 and not self.commas):
            hint = " (KITTI poses carry no stamps: write TUM lines)" if len(self.fields) == 12 else ""
            raise TrajectoryError(
                f"{self.where}: expected 8 numbers `t x y z qx qy qz qw`, got {len(self.fields)} fields: {shown}{hint}"
            )
        try:
            x, y, z, a, b, c, d = (float(field) for field in self.fields[1:8])
        except ValueError:
            raise TrajectoryError(f"{self.where}: expected 8 numbers `t x y z qx qy qz qw`, got {shown}") from None
        if not np.isfinite((x, y, z, a, b, c, d)).all():
            raise TrajectoryError(
                f"{self.where}: expected finite numbers, got {shown}; leave out poses that are not known"
            )
        # EuRoC files alone write the quaternion as w x y z.
        return self._stamp(), [x, y, z, b, c, d, a] if self.commas else [x, y, z, a, b, c, d]

    def _stamp(self) -> int:
        text = self.fields[0]
        try:
            if not self.nanoseconds:
                if abs(float(text)) > MAX_SECONDS:
                    raise TrajectoryError(
                        f"{self.where}: expected a stamp in seconds (or nanoseconds since 1970), got {text}, "
                        "which looks like milli- or microseconds; write seconds"
                    )
                return seconds_to_ns(text)
            stamp = _to_integer(text, 0)
            if self.commas and Decimal(text) != stamp:
                raise TrajectoryError(
                    f"{self.where}: expected a stamp in whole nanoseconds, as lines with commas are EuRoC, got {text}; "
                    "write `t x y z qx qy qz qw` with spaces for stamps in seconds"
                )
        except ValueError:
            raise TrajectoryError(f"{self.where}: expected a stamp, got {text[:40]!r}") from None
        if abs(stamp) >= 2**63:
            raise TrajectoryError(f"{self.where}: expected a stamp of at most 2^63 ns, got {text[:40]}")
        return stamp


def _float_or_nan(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def write_tum(path: str | os.PathLike[str], trajectory: Trajectory) -> None:
    """Write `t x y z qx qy qz qw`, seconds with nine decimals, nothing half-written."""
    rows = ["# timestamp_s x_m y_m z_m qx qy qz qw"]
    for stamp, position, quaternion in zip(
        trajectory.stamps_ns, trajectory.positions, trajectory.quaternions, strict=True
    ):
        rows.append(" ".join([ns_to_seconds(stamp), *(f"{value:.12g}" for value in (*position, *quaternion))]))
    write_atomically(path, ("\n".join(rows) + "\n").encode())
