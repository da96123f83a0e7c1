"""Trajectory files as they are found in the wild, and stamps to the nanosecond."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.trajectory import Trajectory, ns_to_seconds, read_trajectory, seconds_to_ns, write_tum
from oysterbench.core.trajectory.columns import EUROC, TUM
from oysterbench.core.trajectory.stamps import scaled_integer, scaled_integers
from oysterbench.core.trajectory.table import WORTH_COMPILED, read_table

POSE = "1 2 3 0 0 0.6 0.8"


def read(tmp_path, text: str | bytes):
    path = tmp_path / "poses.txt"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_trajectory(path)


def refusal(tmp_path, text: str | bytes) -> str:
    with pytest.raises(TrajectoryError) as caught:
        read(tmp_path, text)
    message = str(caught.value).removeprefix(str(tmp_path) + "/")
    assert message.startswith("poses.txt")
    assert "\n" not in message
    return message


@given(st.integers(-(2**63) + 1, 2**63 - 1))
def test_stamps_survive_text(stamp_ns):
    assert seconds_to_ns(ns_to_seconds(stamp_ns)) == stamp_ns


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("1403636580.838555648", 1403636580838555648),
        ("1403636580.8385556480", 1403636580838555648),
        ("1.403636580838555648e+09", 1403636580838555648),
        ("1.499999999999999944e-01", 150_000_000),
        ("0.14999999999999999", 150_000_000),
        ("-0.5", -500_000_000),
        ("5", 5_000_000_000),
        (" .25 ", 250_000_000),
    ],
)
def test_seconds_are_read_to_the_nanosecond(text, stamp_ns):
    assert seconds_to_ns(text) == stamp_ns


@pytest.mark.parametrize("text", ["", "nan", "inf", "1e400", "12:30", "1.2.3"])
def test_a_text_that_is_no_time_is_refused(text):
    with pytest.raises(ValueError, match="not a"):
        seconds_to_ns(text)


def test_tum_file_is_read_with_comments_blanks_tabs_and_repeated_spaces(tmp_path):
    head = "\ufeff# timestamp tx ty tz qx qy qz qw\r\n\r\n  # more\n"
    trajectory = read(tmp_path, head + f"1403636580.838555648\t1  2\t3 0 0 0.6   0.8 \r\n\n2e9 {POSE}")
    np.testing.assert_array_equal(trajectory.stamps_ns, [1403636580838555648, 2 * 10**18])
    np.testing.assert_array_equal(trajectory.positions, [[1, 2, 3]] * 2)
    np.testing.assert_array_equal(trajectory.quaternions, [[0, 0, 0.6, 0.8]] * 2)


@pytest.mark.parametrize(
    "header", ["", "#timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z\n", "timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z\n"]
)
def test_euroc_file_has_the_quaternion_as_w_x_y_z(tmp_path, header):
    trajectory = read(tmp_path, header + "1403636580838555648, 1,2,3, 0.8,0,0,0.6, 9,9,9,0,0,0,0,0,0\n")
    assert trajectory.stamps_ns[0] == 1403636580838555648
    np.testing.assert_array_equal(trajectory.quaternions, [[0, 0, 0.6, 0.8]])


def test_nanoseconds_with_spaces_are_read_as_orb_slam_writes_them(tmp_path):
    trajectory = read(tmp_path, f"1403636579763555584.000000 {POSE}\n1403636579813555456.000000 {POSE}\n")
    np.testing.assert_array_equal(trajectory.stamps_ns, [1403636579763555584, 1403636579813555456])
    np.testing.assert_array_equal(trajectory.quaternions[0], [0, 0, 0.6, 0.8])


@pytest.mark.parametrize("stamp", ["1403636579763", "1403636579763555"])
def test_milli_and_microseconds_are_refused(tmp_path, stamp):
    assert "poses.txt:1: expected a timestamp in seconds" in refusal(tmp_path, f"{stamp} {POSE}")


def test_a_change_of_layout_within_a_file_is_refused(tmp_path):
    message = refusal(tmp_path, f"1 {POSE}\n1403636579763555584 {POSE}")
    assert message.startswith("poses.txt:2: expected timestamps in s as on the lines before, got nanoseconds")
    assert ":2: expected spaces between the numbers as on the lines before, got commas" in refusal(
        tmp_path, f"1 {POSE}\n1,1,2,3,1,0,0,0"
    )


def test_seconds_with_commas_are_refused_with_the_way_out(tmp_path):
    message = refusal(tmp_path, "1403636580.84,1,2,3,1,0,0,0")
    assert "whole nanoseconds" in message
    assert "with spaces" in message


@pytest.mark.parametrize("columns", [7, 9, 12])
def test_a_wrong_number_of_columns_is_refused_with_file_and_line(tmp_path, columns):
    message = refusal(tmp_path, f"# header\n1 {POSE}\n" + " ".join(["1"] * columns))
    assert message.startswith(f"poses.txt:3: expected 8 numbers `t x y z qx qy qz qw`, got {columns} fields")
    assert ("KITTI" in message) == (columns == 12)


@pytest.mark.parametrize(
    "line", ["1 2 x 3 0 0 0 1", "1 2 nan 3 0 0 0 1", "1 inf 2 3 0 0 0 1", "soon 1 2 3 0 0 0 1", "nan " + POSE]
)
def test_what_is_no_finite_number_is_refused_with_file_and_line(tmp_path, line):
    assert refusal(tmp_path, f"1 {POSE}\n\n{line}\n").startswith("poses.txt:3: expected ")


def test_a_second_line_of_names_is_not_skipped(tmp_path):
    assert refusal(tmp_path, f"t x y z qx qy qz qw\n1 {POSE}\nt x y z qx qy qz qw").startswith("poses.txt:3")


@pytest.mark.parametrize("text", ["", "\n\n", "# only a comment\n", "t x y z qx qy qz qw\n"])
def test_an_empty_file_is_refused(tmp_path, text):
    assert "no pose; expected lines of" in refusal(tmp_path, text)


@pytest.mark.parametrize("content", [bytes(range(256)), b"\0\1\2" * 50, f"1 {POSE}\n".encode("utf-16")])
def test_a_binary_file_is_refused(tmp_path, content):
    assert "is not text" in refusal(tmp_path, content)


words = st.sampled_from(
    ["1", "0.5", "1e3", "nan", "-inf", "1403636579763555584", "x", "#", ",", "1e999", "0x1", "−1", ""]
)
line_texts = st.lists(words, max_size=10).map(" ".join) | st.lists(words, min_size=8, max_size=9).map(",".join)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(line_texts | st.text(max_size=20), max_size=4).map("\n".join))
def test_any_text_is_read_or_refused_in_one_line(tmp_path, text):
    path = tmp_path / "poses.txt"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    message = None
    try:
        assert np.isfinite(read_trajectory(path).positions).all()
    except TrajectoryError as error:
        message = str(error)
    assert message is None or (message.startswith(str(path)) and "\n" not in message)


def test_what_is_no_file_is_refused(tmp_path):
    with pytest.raises(TrajectoryError, match="no such file"):
        read_trajectory(tmp_path / "absent.txt")
    with pytest.raises(TrajectoryError, match="is a folder"):
        read_trajectory(tmp_path)


def test_a_written_file_reads_back(tmp_path):
    rng = np.random.Generator(np.random.Philox(1))
    quaternions = rng.normal(size=(5, 4))
    trajectory = Trajectory(
        np.arange(5, dtype=np.int64) * 33_333_333 + 1_700_000_000_123_456_789,
        rng.normal(size=(5, 3)) * 1000,
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
    )
    write_tum(tmp_path / "out" / "poses.txt", trajectory)
    again = read_trajectory(tmp_path / "out" / "poses.txt")
    np.testing.assert_array_equal(again.stamps_ns, trajectory.stamps_ns)
    np.testing.assert_allclose(again.positions, trajectory.positions, rtol=1e-11)
    np.testing.assert_allclose(again.quaternions, trajectory.quaternions, rtol=0, atol=1e-11)


def test_arrays_of_different_lengths_are_refused():
    with pytest.raises(TrajectoryError, match="expected 2 positions"):
        Trajectory(np.array([1, 2]), np.zeros((3, 3)), np.zeros((2, 4)))


def test_path_length_and_selection():
    trajectory = Trajectory(
        np.arange(3), np.array([[0.0, 0, 0], [3, 4, 0], [3, 4, 2]]), np.tile([0.0, 0, 0, 1], (3, 1))
    )
    assert trajectory.path_length == 7
    assert trajectory.select(slice(0, 2)).path_length == 5
    np.testing.assert_allclose(trajectory.matrices[1, :3, 3], [3, 4, 0])


def test_a_pose_written_twice_is_taken_once_and_said(tmp_path):
    trajectory = read(tmp_path, f"1 {POSE}\n1 {POSE}\n2 {POSE}\n2 {POSE}\n2 {POSE}")
    assert trajectory.stamps_ns.tolist() == [10**9, 2 * 10**9]
    assert trajectory.notes == ("poses.txt: 3 poses were written twice and are taken once",)


def test_two_poses_at_one_stamp_are_refused_with_their_lines(tmp_path):
    message = refusal(tmp_path, f"# t x\n1 {POSE}\n2 {POSE}\n2 9 2 3 0 0 0.6 0.8\n")
    assert message == (
        "poses.txt:4: expected one pose for each timestamp, got another one at 2.000000000 s than on poses.txt:3, 8 m "
        "and 0 deg away; keep one of them (--duplicates first, last or mean; of the truth, --truth-duplicates)"
    )


WALK = "".join(f"{k} {k}.0 2 3 0 0 {np.sin(k / 20):.12f} {np.cos(k / 20):.12f}\n" for k in range(1, 9))
NEAR = f"4 4.001 2 3 0 0 {np.sin(0.201):.12f} {np.cos(0.201):.12f}"


def test_of_poses_at_one_stamp_that_differ_by_less_than_neighbours_the_first_is_taken_and_it_is_said(tmp_path):
    """As TUM's fr2_desk has them in its motion capture, and ORB-SLAM in its key frames."""
    trajectory = read(tmp_path, WALK.replace("\n5 ", f"\n{NEAR}\n5 "))
    assert trajectory.stamps_ns.tolist() == [k * 10**9 for k in range(1, 9)]
    assert trajectory.positions[3, 0] == 4.0
    assert trajectory.notes == (
        "poses.txt: at 1 of 8 timestamps there are several poses, up to 0.001 m and 0.115 deg apart: the first is "
        "taken (--duplicates)",
    )


@pytest.mark.parametrize(("choice", "x"), [("first", 4.0), ("last", 4.001), ("mean", 4.0005)])
def test_an_option_decides_which_of_several_poses_counts(tmp_path, choice, x):
    (tmp_path / "poses.txt").write_text(WALK.replace("\n5 ", f"\n{NEAR}\n5 "))
    trajectory = read_trajectory(tmp_path / "poses.txt", duplicates=choice)
    assert len(trajectory) == 8
    assert trajectory.positions[3, 0] == pytest.approx(x, abs=1e-12)
    turned = 2 * np.arctan2(trajectory.quaternions[3, 2], trajectory.quaternions[3, 3])
    assert turned == pytest.approx({"first": 0.4, "last": 0.402, "mean": 0.401}[choice], abs=1e-9)


def test_poses_at_one_stamp_are_refused_where_that_was_chosen_or_where_they_are_far_apart(tmp_path):
    path = tmp_path / "poses.txt"
    path.write_text(WALK.replace("\n5 ", f"\n{NEAR}\n5 "))
    with pytest.raises(TrajectoryError, match=r"poses\.txt:5: expected one pose for each timestamp"):
        read_trajectory(path, duplicates="refuse")
    turned = WALK.replace("\n5 ", "\n4 4 2 3 1 0 0 0\n5 ")
    for text in (WALK.replace("\n5 ", "\n4 7 2 3 0 0 0 1\n5 "), turned):
        path.write_text(text)
        with pytest.raises(TrajectoryError, match=r"poses\.txt:5: .*--duplicates first, last or mean"):
            read_trajectory(path)
        assert len(read_trajectory(path, duplicates="last")) == 8


def test_stamps_that_go_back_are_refused_with_line_and_option(tmp_path):
    message = refusal(tmp_path, f"1 {POSE}\n3 {POSE}\n\n2.5 {POSE}\n")
    assert message == (
        "poses.txt:4: expected increasing timestamps, got 2.500000000 s after 3.000000000 s; sort the poses by time "
        "(--sort)"
    )
    trajectory = read_trajectory(tmp_path / "poses.txt", sort=True)
    assert trajectory.stamps_ns.tolist() == [10**9, 2_500_000_000, 3 * 10**9]
    assert trajectory.notes == ("poses.txt: the poses were put in the order of their timestamps",)


def test_a_quaternion_that_is_no_rotation_is_refused_with_its_line(tmp_path):
    message = refusal(tmp_path, f"1 {POSE}\n2 1 2 3 0 0 0.6 0.9\n")
    assert message.startswith("poses.txt:2: expected a unit quaternion, got norm 1.082;")
    assert "got norm above 1e+200" in refusal(tmp_path, "1 1 2 3 0 0 1e200 0")


def test_quaternions_with_few_decimals_are_normalised_and_said(tmp_path):
    trajectory = read(tmp_path, f"1 {POSE}\n2 1 2 3 0 0 0.707 0.707\n")
    np.testing.assert_allclose(np.linalg.norm(trajectory.quaternions, axis=1), 1, rtol=0, atol=1e-15)
    assert trajectory.notes == ("poses.txt: 1 of 2 quaternions were normalised; their norms were off by up to 0.00015",)


def test_nan_is_named_with_line_and_column(tmp_path):
    message = refusal(tmp_path, f"1 {POSE}\n2 1 2 nan 0 0 0 1\n")
    assert message == "poses.txt:2: expected finite numbers, got z = nan; leave out unknown poses"


def test_nanoseconds_in_a_seconds_file_are_exact_and_said(tmp_path):
    # A float64 near 1.4e18 has a spacing of 256.
    trajectory = read(tmp_path, f"1403636579763555585 {POSE}\n1403636579763555586 {POSE}\n")
    assert trajectory.stamps_ns.tolist() == [1403636579763555585, 1403636579763555586]
    assert trajectory.notes == ("poses.txt: the timestamps can only be nanoseconds and are read as such",)


def test_a_header_in_a_comment_tells_the_order_of_the_quaternion(tmp_path):
    trajectory = read(tmp_path, "# t x y z qw qx qy qz\n1 1 2 3 0.8 0 0 0.6\n")
    np.testing.assert_array_equal(trajectory.quaternions, [[0, 0, 0.6, 0.8]])


def test_numbers_that_only_python_reads_are_refused(tmp_path):
    assert "expected a number for x, got '1_0'" in refusal(tmp_path, "1 1_0 2 3 0 0 0 1")
    assert "expected a timestamp, got '١'" in refusal(tmp_path, "١ 1 2 3 0 0 0 1")


def test_a_line_that_breaks_off_is_refused(tmp_path):
    message = refusal(tmp_path, f"1 {POSE}\n2 1 2 3 0 0")
    assert message.startswith("poses.txt:2: expected 8 numbers `t x y z qx qy qz qw`, got 6 fields")


numbers = st.floats(-1e3, 1e3).map(repr) | st.sampled_from(
    ["1", "-0", "1.", ".5", "+2", "1e-3", "1E+2", "00.10", "2e400"]
)
spaces = st.sampled_from([" ", "  ", "\t", " \t"])
stamps = st.integers(0, 2**62).map(ns_to_seconds) | st.sampled_from(["1", "1.5e9", "1.0000000001", "9" * 25])


@st.composite
def plain_files(draw):
    comma = draw(st.booleans())
    lines = []
    for _ in range(draw(st.integers(1, 6))):
        if draw(st.integers(0, 5)) == 0:
            lines.append(draw(st.sampled_from(["", "# note", "  ", "% note", "1 2"])))
        fields = [draw(stamps), *(draw(numbers) for _ in range(draw(st.sampled_from([7, 7, 7, 7, 7, 6, 8]))))]
        sign = draw(st.sampled_from([",", ", "])) if comma else draw(spaces)
        lines.append(sign.join(fields))
    return "\n".join(lines)


@settings(max_examples=300, deadline=None)
@given(plain_files(), st.sampled_from([TUM, EUROC]))
def test_the_compiled_reader_and_the_one_by_lines_agree(text, columns):
    def outcome(compiled: bool):
        try:
            table = read_table(text, 0, columns, "poses.txt", compiled)
        except TrajectoryError as error:
            return str(error)
        return (
            table.stamps.tolist(),
            table.sizes.tolist(),
            table.values.tolist(),
            [table.where(i) for i in range(len(table))],
        )

    assert outcome(True) == outcome(False)


@given(st.lists(stamps | st.integers(0, 2**63 - 1).map(str), min_size=1, max_size=8), st.sampled_from([0, 3, 6, 9]))
def test_stamps_are_converted_together_as_they_are_one_by_one(texts, shift):
    expected = [scaled_integer(text, shift) for text in texts]
    if all(abs(value) < 2**63 for value in expected):
        assert scaled_integers(texts, shift).tolist() == expected
    else:
        with pytest.raises(OverflowError):
            scaled_integers(texts, shift)


def test_covariances_go_with_their_poses():
    covariances = np.arange(4)[:, None, None] * np.eye(6)
    stamps_ns = np.arange(4, dtype=np.int64) * 10
    trajectory = Trajectory(stamps_ns, np.zeros((4, 3)), np.tile([0.0, 0, 0, 1], (4, 1)), covariances)
    assert trajectory.select(slice(2, 4)).covariances[:, 0, 0].tolist() == [2, 3]
    assert trajectory.at(np.array([0, 4, 16, 30])).covariances[:, 0, 0].tolist() == [0, 0, 2, 3]
    with pytest.raises(TrajectoryError, match="expected 4 covariances"):
        Trajectory(stamps_ns, trajectory.positions, trajectory.quaternions, covariances[:3])


def test_a_large_file_is_read_at_once_and_its_errors_still_name_the_line(tmp_path):
    lines = [
        f"{ns_to_seconds(1_700_000_000_123_456_789 + i * 50_000_000)} {i} 0.25 -1e-3 0 0 0.6 0.8" for i in range(4000)
    ]
    text = "# poses\n\n" + "\n".join(lines) + "\n"
    assert len(text) > WORTH_COMPILED
    trajectory = read(tmp_path, text)
    assert trajectory.stamps_ns[[0, -1]].tolist() == [1_700_000_000_123_456_789, 1_700_000_200_073_456_789]
    np.testing.assert_array_equal(trajectory.positions[:, 0], np.arange(4000))
    assert refusal(tmp_path, text.replace(" 3000 ", " nan ")).startswith(
        "poses.txt:3003: expected finite numbers, got x"
    )
    assert refusal(tmp_path, text.replace(" 3000 0.25 -1e-3 0 ", " 3000 0.25 -1e-3 1 ")).startswith(
        "poses.txt:3003: expected a unit quaternion, got norm 1.4"
    )
