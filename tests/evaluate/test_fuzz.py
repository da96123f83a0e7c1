"""Ten thousand damaged and made-up files: each is refused in one line, or read as exactly what stands in it."""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from oysterbench.core.errors import OysterbenchError, TrajectoryError
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory, read_trajectory
from oysterbench.core.trajectory.stamps import scaled_integer
from oysterbench.evaluate.slam.inputs import read_pair
from oysterbench.evaluate.slam.scoring import score
from tests.helpers import trajectory_files as files
from tests.helpers.trajectory_files import dive

TRUTH = dive(12, covariances=True)
TEXT = ("tum", "euroc", "kitti", "csv")
CHECKED = ("npz", "mcap")
"""Formats with checksums over all that matters: no damage may pass."""
BAGS = ("bag1", "bag2")
"""Formats without: a changed byte of a number is another number."""
FORMATS = (*TEXT, *CHECKED, *BAGS)


@pytest.fixture(scope="module")
def originals(tmp_path_factory) -> dict[str, bytes]:
    """A valid file in every format, as bytes."""
    folder = tmp_path_factory.mktemp("originals")
    files.write_bag1(folder / "a.bag", TRUTH)
    (database,) = files.write_bag2(folder / "b", TRUTH).glob("*.db3")
    data = {form: getattr(files, form)(TRUTH) for form in (*TEXT, *CHECKED)}
    return data | {"bag1": (folder / "a.bag").read_bytes(), "bag2": database.read_bytes()}


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """One to three small damages: a bit, a byte, a cut, a repetition, an insertion, an exchange of lines."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        i, j = sorted(rng.integers(0, max(len(out), 1), 2).tolist())
        kind = rng.integers(0, 8)
        if kind == 0 and out:
            out[i] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1 and out:
            out[i] = int(rng.integers(0, 256))
        elif kind == 2:
            del out[i : i + int(rng.integers(1, 20))]
        elif kind == 3:
            out = out[:j]
        elif kind == 4:
            out[i:i] = out[j : j + int(rng.integers(1, 60))]
        elif kind == 5:
            words = (
                b"nan",
                b"-inf",
                b"\n",
                b" ",
                b"\t",
                b",",
                b"#",
                b"0",
                b"9",
                b".",
                b"e",
                b"-",
                b"\xff",
                b"\0",
                b"1e999",
            )
            out[i:i] = words[int(rng.integers(0, len(words)))]
        elif kind == 6:
            lines = bytes(out).split(b"\n")
            a, b = rng.integers(0, len(lines), 2).tolist()
            lines[a], lines[b] = lines[b], lines[a]
            out = bytearray(b"\n".join(lines))
        elif out:
            out[i] = b"0123456789.-e \n,"[int(rng.integers(0, 16))]
    return bytes(out)


def read(path: Path, form: str) -> Trajectory | str:
    """The trajectory, or the message of a refusal, which is one line that names the file."""
    try:
        return read_trajectory(path, times=TRUTH.stamps_ns if form == "kitti" else None)
    except TrajectoryError as error:
        message = str(error)
    assert str(path) in message
    assert "\n" not in message
    return message


def assert_sound(trajectory: Trajectory) -> None:
    """What any trajectory that is read is."""
    assert len(trajectory) > 0
    assert trajectory.stamps_ns.dtype == np.int64
    assert (np.diff(trajectory.stamps_ns) > 0).all()
    assert np.isfinite(trajectory.positions).all()
    np.testing.assert_allclose(np.linalg.norm(trajectory.quaternions, axis=1), 1, rtol=0, atol=1e-5)
    if trajectory.covariances is not None:
        assert np.isfinite(trajectory.covariances).all()


def lines_of(data: bytes) -> list[list[str]]:
    """Fields of the lines that hold numbers, split in the plainest way."""
    lines = data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    kept = [line for line in lines if line.strip() and line.strip()[0] not in "#%"]
    return [re.split(r"[,;]", line) if re.search("[,;]", line) else line.split() for line in kept]


def assert_as_written(trajectory: Trajectory, data: bytes, form: str) -> None:
    """Every pose is a line of the text, number for number, and every line is a pose (once)."""
    rows = lines_of(data)
    order = {"tum": [0, 1, 2, 3, 4, 5, 6, 7], "euroc": [0, 1, 2, 3, 5, 6, 7, 4], "csv": [8, 6, 5, 4, 1, 2, 3, 0]}
    header = next((row for row in rows if not re.search(r"\d", row[0])), None) if form == "csv" else None
    rows = [row for row in rows if row is not header]
    if form == "kitti":
        assert len(rows) == len(trajectory)
        np.testing.assert_array_equal([[float(row[k]) for k in (3, 7, 11)] for row in rows], trajectory.positions)
        return
    given = [[row[k].strip() for k in order[form]] for row in rows]
    # Damage to the first line may have made it a comment, or the stamps' unit another one; both are then said.
    units = [unit for unit in (9, 6, 3, 0) if scaled_integer(given[0][0], unit) == trajectory.stamps_ns[0]]
    assert units
    poses = list(dict.fromkeys((scaled_integer(row[0], units[0]), *map(float, row[1:4])) for row in given))
    assert [pose[0] for pose in poses] == trajectory.stamps_ns.tolist()
    np.testing.assert_array_equal([pose[1:] for pose in poses], trajectory.positions)
    quaternions = {scaled_integer(row[0], units[0]): list(map(float, row[4:])) for row in given}
    np.testing.assert_allclose(
        [quaternions[stamp] for stamp in trajectory.stamps_ns.tolist()], trajectory.quaternions, rtol=0, atol=3e-3
    )


def assert_few_differ(trajectory: Trajectory, original: Trajectory, changes: int) -> None:
    """Poses of a bag are those of the original, but for as many as bytes were changed."""
    own = Counter(map(tuple, np.column_stack([original.positions, original.quaternions]).tolist()))
    there = Counter(map(tuple, np.column_stack([trajectory.positions, trajectory.quaternions]).tolist()))
    assert len(trajectory) == len(original) or trajectory.notes != original.notes
    assert (there - own).total() <= changes
    assert (own - there).total() <= changes


def mutate_and_read(folder: Path, originals: dict[str, bytes], form: str, count: int, salt: str) -> Counter[str]:
    """What became of `count` mutations of a file: refused, same or other numbers."""
    outcomes: Counter[str] = Counter()
    suffix = {"bag1": ".bag", "bag2": ".db3"}.get(form, ".dat")
    path = folder / f"mutated{suffix}"
    path.write_bytes(originals[form])
    original = read(path, form)
    assert isinstance(original, Trajectory)
    for k in range(count):
        data = mutated(originals[form], stream(11, b"", "fuzz", salt, form, k))
        path.write_bytes(data)
        got = read(path, form)
        if isinstance(got, str):
            outcomes["refused"] += 1
            continue
        assert_sound(got)
        same = len(got) == len(original) and bool(
            (got.positions == original.positions).all()
            and (got.quaternions == original.quaternions).all()
            and (got.stamps_ns == original.stamps_ns).all()
        )
        if form in CHECKED:
            assert same, f"mutation {k} of {form} passed with other numbers"
        elif form in TEXT:
            assert_as_written(got, data, form)
        else:
            assert_few_differ(got, original, 3)
        outcomes["same" if same else "other numbers"] += 1
    return outcomes


@pytest.mark.parametrize("form", FORMATS)
def test_a_damaged_file_is_refused_or_read_as_what_stands_in_it(tmp_path, originals, form):
    outcomes = mutate_and_read(tmp_path, originals, form, 40, "few")
    assert outcomes["refused"] > 0


@pytest.mark.slow
def test_ten_thousand_damaged_files_are_refused_or_read_as_what_stands_in_them(tmp_path, originals):
    total: Counter[str] = Counter()
    for form in FORMATS:
        outcomes = mutate_and_read(tmp_path, originals, form, 1250, "many")
        print(form, dict(outcomes))
        total += outcomes
    assert total.total() == 10_000


words = st.sampled_from(
    [
        "1",
        "0.5",
        "1e3",
        "nan",
        "-inf",
        "1403636579763555584",
        "x",
        "#",
        ",",
        "1e999",
        "0x1",
        "−1",
        "",
        "t",
        "qx",
        "[ns]",
    ]
)
line_texts = st.lists(words, max_size=13).map(" ".join) | st.lists(words, min_size=8, max_size=9).map(",".join)
texts = st.lists(line_texts | st.text(max_size=20), max_size=4).map("\n".join)


def read_anything(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    got = read(path, "any")
    if isinstance(got, Trajectory):
        assert_sound(got)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(texts.map(lambda text: text.encode("utf-8", "surrogatepass")) | st.binary(max_size=200))
def test_any_bytes_are_read_or_refused_in_one_line(tmp_path, data):
    read_anything(tmp_path / "poses.dat", data)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from([b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"SQLite format 3\0", b"PK\x03\x04"]), st.binary(max_size=200)
)
def test_any_bytes_behind_a_true_beginning_are_refused_in_one_line(tmp_path, magic, data):
    path = tmp_path / "poses.db3"
    path.write_bytes(magic + data)
    assert isinstance(read(path, "any"), str)


@pytest.mark.slow
@settings(max_examples=10_000, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(texts.map(lambda text: text.encode("utf-8", "surrogatepass")) | st.binary(max_size=300))
def test_ten_thousand_made_up_files_are_read_or_refused_in_one_line(tmp_path, data):
    read_anything(tmp_path / "poses.dat", data)


def test_what_is_read_is_scored_or_refused_with_finite_numbers(tmp_path, originals):
    """Damaged estimates through the whole way to the numbers: none is NaN without a reason."""
    (tmp_path / "truth.csv").write_bytes(originals["csv"])
    results = []
    for k in range(150):
        path = tmp_path / "estimate.tum"
        path.write_bytes(mutated(originals["tum"], stream(11, b"", "fuzz", "scored", k)))
        with contextlib.suppress(OysterbenchError):
            results.append(score(*read_pair(tmp_path / "truth.csv", path)))
    assert len(results) > 5
    for result in results:
        for name, value in result.metrics.items():
            assert np.isfinite(value) or name in result.reasons, name
