"""Tables with several columns of times: one time in several units, or times that only have one name."""

from __future__ import annotations

import pytest

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.trajectory import read_trajectory
from tests.helpers.trajectory_files import written

POSE = "x,y,z,qx,qy,qz,qw"


def table(tmp_path, names, *rows):
    lines = [f"{names},{POSE}", *(f"{row},{k},2,3,0,0,0,1" for k, row in enumerate(rows))]
    return written(tmp_path, "\n".join(lines).encode())


@pytest.mark.parametrize(
    ("names", "first", "last"),
    [
        ("timestamp,timestamp_ns", "1700000000.25,1700000000550000000", "1700000010.25,1700000010550000000"),
        ("timestamp_ns,timestamp", "1700000000550000000,1700000000.25", "1700000010550000000,1700000010.25"),
        ("time,time_us", "1700000000.25,0", "1700000010.25,10000000"),
        ("timestamp,timestamp_ms", "12.5,0", "22.5,10000"),
        ("timestamp,timestamp_ns", "12,500000000", "22,0"),
        ("time,time_ns", "12,500000000", "22,500000010"),
        ("time_s,time_ns", "12,500000000", "22,600000000"),
        ("t [s],t [ms]", "12.5,12500", "22.5,22510"),
        ("timestamp,timestamp", "12.5,12500", "22.5,22500"),
        ("timestamp,timestamp_us", "12,500", "22,500"),
        ("time,time_ms", "12,0", "22,0"),
        ("timestamp_ns,timestamp", "12500000000,", "22500000000,"),
        ("time,Time", "100.000,100.012", "110.000,110.012"),
        ("timestamp,timestamp", "1700000000.1,1700000005.1", "1700000010.1,1700000015.1"),
        ("__time,/time", "0.000,0.002", "10.0,10.002"),
        ("time,Time", "1700000000250,1700000000252", "1700000010250,1700000010252"),
        ("header/stamp,pose/header/stamp", "1700000000.25,1700000000.227", "1700000010.25,1700000010.227"),
        ("time_s,time_ns", "0,100000000", "0,400000000"),
        ("time_s,time_ms", "12.50,12506", "22.50,22506"),
    ],
)
def test_times_of_one_name_that_differ_in_every_unit_are_refused(tmp_path, names, first, last):
    """As where one is the message's and the other the recording's, or both are parts of one stamp."""
    one, other = sorted(names.split(","))
    wanted = r"expected one time in '.*' and '.*', by their names, got .* first, .* last; delete the one that is not"
    with pytest.raises(TrajectoryError, match=wanted) as refused:
        read_trajectory(table(tmp_path, names, first, last))
    assert f"{one!r}" in str(refused.value)
    assert f"{other!r}" in str(refused.value)


@pytest.mark.parametrize(
    ("names", "first", "last"),
    [
        ("timestamp,timestamp_ns", "12.5,12500000000", "22.5,22500000000"),
        ("timestamp_ms,timestamp_ns", "12500,12500100000", "22500,22500900000"),
        ("timestamp,timestamp_s", "12500000,12.5", "22500000,22.5"),
        ("t_ns,t", "12500000000,12500", "22500000000,22500"),
        ("timestamp,timestamp_s,timestamp_ms", "12500000,12.5,12500", "22500000,22.5,22500"),
        ("time,Time", "12.5,12.5000001", "22.5,22.5"),
        ("timestamp,time_s", "12500000,12.5", "22500000,22.5"),
        ("time_ms,stamp", "12500,12500000000", "22500,22500000000"),
        ("time_s,time_ms", "12.50,12503", "22.50,22497"),
        ("timestamp_ns,Timestamp", "12500000000,2023-11-14 22:13:20.25", "22500000000,2023-11-14 22:13:30.25"),
        ("Time,time_s", "10:13:20 PM,12.5", "10:13:30 PM,22.5"),
    ],
)
def test_one_time_in_several_units_is_read(tmp_path, names, first, last):
    """Also in a column whose name does not say its unit, beside one of another name that does, as PX4's us."""
    stamps = read_trajectory(table(tmp_path, names, first, last)).stamps_ns
    assert abs(stamps - [12_500_000_000, 22_500_000_000]).max() <= 100_000


def test_a_time_of_another_name_that_differs_says_nothing_of_the_stamp(tmp_path):
    path = table(tmp_path, "timestamp,time_s", "12.5,0", "22.5,10")
    assert read_trajectory(path).stamps_ns.tolist() == [12_500_000_000, 22_500_000_000]


@pytest.mark.parametrize(("unit", "first"), [("ns", 550_000_000), ("s", 250_000_000), ("us", 250)])
def test_of_times_that_differ_the_one_in_the_unit_that_is_asked_for_is_read(tmp_path, unit, first):
    path = table(tmp_path, "timestamp,timestamp_ns", "0.25,550000000", "10.25,10550000000")
    assert read_trajectory(path, time_unit=unit).stamps_ns.tolist()[0] == first


@pytest.mark.parametrize(
    ("names", "rows", "stamps_ms"),
    [
        ("t_s,t_ms", ("0.00,0", "0.03,33", "0.07,67"), [0, 30, 70]),
        ("t_ms,t_us", ("0,400", "33,33300", "67,66900"), [0, 33, 67]),
    ],
)
def test_short_times_may_be_rounded_to_their_last_digit(tmp_path, names, rows, stamps_ms):
    stamps = read_trajectory(table(tmp_path, names, *rows)).stamps_ns
    assert stamps.tolist() == [1_000_000 * stamp for stamp in stamps_ms]


def test_a_time_in_s_says_so_of_whole_stamps_in_the_order_of_euroc(tmp_path):
    rows = "".join(f"{k},1,2,3,1,0,0,0,{k}.0\n" for k in (12, 13))
    path = written(tmp_path, f"timestamp,x,y,z,qw,qx,qy,qz,time_s\n{rows}".encode())
    assert read_trajectory(path).stamps_ns.tolist() == [12_000_000_000, 13_000_000_000]


def test_a_unit_that_is_asked_for_does_not_tell_two_times_without_one_apart(tmp_path):
    path = table(tmp_path, "timestamp,Timestamp", "100.0,100.012", "110.0,110.012")
    with pytest.raises(TrajectoryError, match=r"not the stamp of the poses; one in two parts is stamp_sec, whole, and"):
        read_trajectory(path, time_unit="s")
    path = table(tmp_path, "timestamp,Timestamp", "100.0,100000", "110.0,110000")
    assert read_trajectory(path, time_unit="s").stamps_ns.tolist() == [100_000_000_000, 110_000_000_000]
