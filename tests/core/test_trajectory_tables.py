"""Trajectories in tables of text: what their headers name, and how other programs write them."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.trajectory import read_trajectory
from oysterbench.core.trajectory.columns import named_columns
from tests.helpers import trajectory_files as files
from tests.helpers.trajectory_files import assert_same, dive, written


@pytest.mark.parametrize(
    "header",
    [
        "timestamp_ns,x,y,z,qx,qy,qz,qw",
        "t [ns],p_x,p_y,p_z,q_x,q_y,q_z,q_w",
        "Time (ns); pos_x; pos_y; pos_z; quat_x; quat_y; quat_z; quat_w",
        "stamp_ns\ttx\tty\ttz\tqx\tqy\tqz\tqw",
        "# nanoseconds_time x y z qx qy qz qw",
        "%time,field.pose.position.x,field.pose.position.y,field.pose.position.z,"
        "field.pose.orientation.x,field.pose.orientation.y,field.pose.orientation.z,field.pose.orientation.w",
    ],
)
def test_a_header_may_spell_the_columns_in_many_ways(tmp_path, header):
    text = files.tum(dive()).decode().replace(".", "", 0)
    rows = [line.split() for line in text.splitlines()]
    sign = next((sign for sign in (",", ";", "\t") if sign in header), " ")
    lines = [header, *(sign.join([row[0].replace(".", ""), *row[1:]]) for row in rows)]
    assert_same(read_trajectory(written(tmp_path, "\n".join(lines).encode())), dive())


def test_a_number_that_no_cell_of_a_covariance_has_names_none():
    columns = named_columns(["t", *"xyz", "qx", "qy", "qz", "qw", "cov_7", "cov_36", "cov_²", "cov_" + "9" * 5000])
    assert columns is not None
    assert columns.covariance == {(1, 1): 8}


def test_velocities_and_biases_are_not_taken_for_positions(tmp_path):
    header = "t,v_x,v_y,v_z,b_w_x,b_w_y,b_w_z,w_x,x,y,z,qx,qy,qz,qw"
    trajectory = read_trajectory(written(tmp_path, f"{header}\n1.5,9,9,9,9,9,9,9,1,2,3,0,0,0,1\n".encode()))
    np.testing.assert_array_equal(trajectory.positions, [[1, 2, 3]])


def test_a_header_gives_the_unit_of_the_positions(tmp_path):
    rows = "\n1.5,1000,2000,3000,0,0,0,1\n"
    for header in ("t,x_mm,y_mm,z_mm,qx,qy,qz,qw", "t [s],x [mm],y [mm],z [mm],qx [],qy [],qz [],qw []"):
        path = written(tmp_path, (header + rows).encode())
        np.testing.assert_array_equal(read_trajectory(path).positions, [[1, 2, 3]])
        np.testing.assert_array_equal(read_trajectory(path, unit="m").positions, [[1000, 2000, 3000]])
    path = written(tmp_path, ("t,x_m,y_m,z_m,qx,qy,qz,qw" + rows).encode())
    np.testing.assert_array_equal(read_trajectory(path).positions, [[1000, 2000, 3000]])
    with pytest.raises(TrajectoryError, match="expected a header that names"):
        read_trajectory(written(tmp_path, ("t,x [ft],y [ft],z [ft],qx,qy,qz,qw" + rows).encode()))


@pytest.mark.parametrize("unit", [None, "m", "mm"])
@pytest.mark.parametrize("header", ["x_m,y_m,z_km", "x_mm,y_mm,z_m"])
def test_positions_in_two_units_are_refused_whatever_unit_is_asked_for(tmp_path, unit, header):
    path = written(tmp_path, f"t,{header},qw,qx,qy,qz\n1.5,1,2,3,1,0,0,0\n".encode())
    with pytest.raises(TrajectoryError, match=r"got k?mm? and k?mm?: no one unit is right; convert them"):
        read_trajectory(path, unit=unit)


@pytest.mark.parametrize("unit", ["x_cm,y_cm,z_cm", "x [ft],y [ft],z [ft]"])
@pytest.mark.parametrize("comment", ["", "# "])
def test_a_header_or_comment_with_another_unit_of_the_positions_is_refused(tmp_path, unit, comment):
    path = written(tmp_path, f"{comment}t,{unit},qw,qx,qy,qz\n1.5,1,2,3,1,0,0,0\n".encode())
    with pytest.raises(
        TrajectoryError, match=r"expected a header that names x, y, z in m or mm, got '.*\(--unit m or mm"
    ):
        read_trajectory(path)
    read = read_trajectory(path, unit="mm")
    np.testing.assert_array_equal(read.positions, [[0.001, 0.002, 0.003]])
    np.testing.assert_array_equal(read.quaternions, [[0, 0, 0, 1]])


def pose(position, orientation, sign="_"):
    """Names of seven columns, with what stands before their axes."""
    return ",".join(
        [*(f"{position}{sign}{axis}" for axis in "xyz"), *(f"{orientation}{sign}{axis}" for axis in "xyzw")]
    )


def plotted(topic):
    """Names of a topic's poses, as PlotJuggler writes them."""
    return pose(f"/{topic}/pose/position", f"/{topic}/pose/orientation", "/")


def echoed(k):
    """Names of a path's poses, as `rostopic echo -p` writes them."""
    return pose(f"field.poses{k}.pose.position", f"field.poses{k}.pose.orientation", ".")


TIMES = [
    *(("timestamp", stamp) for stamp in ("header.stamp_ns", "header_stamp_ns", "stamp_ms", "stamp_usecs")),
    *(("timestamp_ns", "header.stamp"), ("t", "time_ms")),
]
"""Names of times of which either may be the stamp, though one has a unit: refused in both orders."""


@pytest.mark.parametrize(
    ("header", "one", "other"),
    [
        (f"__time,{plotted('gt')},{plotted('vio')}", "/gt/pose/position/x", "/vio/pose/position/x"),
        (f"%time,{echoed(0)},{echoed(1)}", "field.poses0.pose.position.x", "field.poses1.pose.position.x"),
        ("t,gt_px,gt_py,gt_pz,px,py,pz,qx,qy,qz,qw", "gt_px", "px"),
        ("t,px,py,pz,qx,qy,qz,qw,gt_px,gt_py,gt_pz", "px", "gt_px"),
        (f"t,p_gt_x,p_gt_y,p_gt_z,{pose('p_est', 'q_est')}", "p_gt_x", "p_est_x"),
        (f"t,target_pos_x,target_pos_y,target_pos_z,{pose('pos', 'q')}", "target_pos_x", "pos_x"),
        ("t,x,y,z,pos_x,pos_y,pos_z,qx,qy,qz,qw", "x", "pos_x"),
        ("t,x_mm,y_mm,z_mm,x_m,y_m,z_m,qx,qy,qz,qw", "x_mm", "x_m"),
        ("t,px,py,pz,gt_qx,gt_qy,gt_qz,gt_qw,vio_qx,vio_qy,vio_qz,vio_qw", "gt_qx", "vio_qx"),
        (f"t,{pose('gt_p', 'vio_q')},vio_p_x,vio_p_y", "gt_p_x", "vio_q_x"),
        (f"header.stamp,stamp,{pose('p', 'q')}", "header.stamp", "stamp"),
        (f"t,stamp,timestamp,{pose('p', 'q')}", "stamp", "timestamp"),
        (f"t,time,{pose('p', 'q')}", "t", "time"),
        (
            f"__time,{plotted('gt')},{plotted('error_state_kf')}",
            "/gt/pose/position/x",
            "/error_state_kf/pose/position/x",
        ),
        (f"__time,{plotted('gt')},{plotted('sd_slam')}", "/gt/pose/position/x", "/sd_slam/pose/position/x"),
        (f"t,{pose('gt_p', 'gt_q')},{pose('sd_p', 'sd_q')}", "gt_p_x", "sd_p_x"),
        (f"sec,nsec,stamp_sec,stamp_nsec,{pose('p', 'q')}", "sec", "stamp_sec"),
        (f"sec,nsec,time_sec,time_nsec,{pose('p', 'q')}", "sec", "time_sec"),
        (
            f"/vio/header/stamp,/vio/odom/header/stamp,{plotted('vio/odom')}",
            "/vio/header/stamp",
            "/vio/odom/header/stamp",
        ),
        (f"timestamp,/vio/header/stamp,{plotted('vio')}", "timestamp", "/vio/header/stamp"),
        (f"__time,/vio/header/stamp,stamp,{plotted('vio')}", "/vio/header/stamp", "stamp"),
        *((f"{one},{other},{pose('p', 'q')}", one, other) for one, other in TIMES),
        *((f"{other},{one},{pose('p', 'q')}", other, one) for one, other in TIMES),
        ("t,x,y,z,pose_x,pose_y,pose_z,qx,qy,qz,qw", "x", "pose_x"),
        (f"t,{pose('pose', 'pose_q')},x,y,z", "pose_x", "x"),
        (f"t,{pose('pose', 'pose_rot')},tx,ty,tz", "pose_x", "tx"),
        (f"t,x,y,z,qx,qy,qz,qw,{pose('pose', 'pose_q')}", "x", "pose_x"),
        (f"t,pose_x,pose_y,pose_z,{pose('pose_position', 'q')}", "pose_x", "pose_position_x"),
        *(
            (f"t,{plotted(topic)},{plotted('gt')}", f"/{topic}/pose/position/x", "/gt/pose/position/x")
            for topic in ("std_slam", "sigma", "vio/error", "error_gt")
        ),
    ],
)
@pytest.mark.parametrize("comment", ["", "# "])
def test_a_table_of_two_poses_is_refused_with_a_column_of_each(tmp_path, header, one, other, comment):
    line = ",".join(["0.5"] * len(header.split(",")))
    path = written(tmp_path, f"{comment}{header}\n{line}\n".encode())
    with pytest.raises(
        TrajectoryError, match=f"expected the columns of one stamp and one pose, got '{one}' and '{other}', which"
    ):
        read_trajectory(path)


@pytest.mark.parametrize(
    ("header", "line"),
    [
        (f"t,imu_qx,imu_qy,imu_qz,imu_qw,{pose('odom_p', 'odom_q')},target_p_z", "1.5,0,1,0,0,1,2,3,0,0,0,1,9"),
        (f"t,{pose('p_RS_R', 'q_RS')}", "1.5,1,2,3,0,0,0,1"),
        (f"time,stamp,{pose('p', 'q')}", "9,1.5,1,2,3,0,0,0,1"),
        (f"timestamp,time,{pose('p', 'q')}", "1.5,9,1,2,3,0,0,0,1"),
        (f"t,{pose('pos', 'q')},pos_std_x,pos_std_y,pos_std_z", "1.5,1,2,3,0,0,0,1,9,9,9"),
        (f"t,{pose('p', 'q')},p_err_x,p_err_y,p_err_z,q_err_x,q_err_y,q_err_z,q_err_w", "1.5,1,2,3,0,0,0,1" + ",9" * 7),
        (f"t,{pose('p', 'q')},rot_x,rot_y,rot_z", "1.5,1,2,3,0,0,0,1,9,9,9"),
        (f"t,rot_x,rot_y,rot_z,{pose('p', 'q')}", "1.5,9,9,9,1,2,3,0,0,0,1"),
        (f"t,{pose('p_W', 'q_WB')}", "1.5,1,2,3,0,0,0,1"),
        ("t,x,y,z,qx,qy,qz,w", "1.5,1,2,3,0,0,0,1"),
        (f"t,{pose('vio_p', 'vio_q')},sigma_px,sigma_py,sigma_pz,std_pose_x", "1.5,1,2,3,0,0,0,1,9,9,9,9"),
        (f"time,timestamp [ns],{pose('p', 'q')}", "9,1500000000,1,2,3,0,0,0,1"),
        (f"stamp_ms,time,{pose('p', 'q')}", "1500,9,1,2,3,0,0,0,1"),
        (f"%time,field.header.stamp_ns,{pose('p', 'q')}", "9,1500000000,1,2,3,0,0,0,1"),
        (f"stamp,time_ns,{pose('p', 'q')}", "1.5,9000000000,1,2,3,0,0,0,1"),
        (f"time_sec,time_nsec,stamp_sec,stamp_nsec,{pose('p', 'q')}", "9,9,1,500000000,1,2,3,0,0,0,1"),
        (f"time_sec,time_nsec,stamp,{pose('p', 'q')}", "9,9,1.5,1,2,3,0,0,0,1"),
        (f"__time,/imu/header/stamp,/vio/header/stamp,{plotted('vio')}", "9,8,1.5,1,2,3,0,0,0,1"),
        (f"__time,/vio/pose/header/stamp,{plotted('vio/pose')}", "9,1.5,1,2,3,0,0,0,1"),
        (f"__time,/vio/header/stamp/sec,/vio/header/stamp/nanosec,{plotted('vio')}", "9,1,500000000,1,2,3,0,0,0,1"),
        (f"time [\u00b5s],{pose('p', 'q')}", "1500000,1,2,3,0,0,0,1"),
        (f"t,sd_px,sd_py,sd_pz,{pose('p', 'q')}", "1.5,9,9,9,1,2,3,0,0,0,1"),
        (f"t,pos_sd_x,pos_sd_y,pos_sd_z,{pose('pos', 'q')}", "1.5,9,9,9,1,2,3,0,0,0,1"),
        (f"t,{pose('pos_sd', 'q_sd')},{pose('pos', 'q')}", "1.5,9,9,9,9,9,9,9,1,2,3,0,0,0,1"),
        (f"t,{pose('sd_p', 'sd_q')},{pose('p', 'q')}", "1.5,9,9,9,9,9,9,9,1,2,3,0,0,0,1"),
        (f"t,{pose('sd_p', 'sd_q')},{pose('pose.position', 'q')}", "1.5,9,9,9,9,9,9,9,1,2,3,0,0,0,1"),
        (f"t,{plotted('vio/error')},{plotted('vio')}", "1.5,9,9,9,9,9,9,9,1,2,3,0,0,0,1"),
        (f"t,{pose('vio_sd_p', 'vio_sd_q')},{pose('p', 'q')}", "1.5,9,9,9,9,9,9,9,1,2,3,0,0,0,1"),
        (f"t,std_dev_px,std_dev_py,std_dev_pz,{pose('p', 'q')}", "1.5,9,9,9,1,2,3,0,0,0,1"),
        (
            f"t,{pose('error.pose.position', 'error.pose.orientation')},{pose('pose.position', 'pose.orientation')}",
            "1.5,9,9,9,9,9,9,9,1,2,3,0,0,0,1",
        ),
        (f"t,x,y,{pose('pose', 'q')}", "1.5,9,9,1,2,3,0,0,0,1"),
        (f"timestamp,time.sec,time.nanosec,{pose('p', 'q')}", "9,1,500000000,1,2,3,0,0,0,1"),
        (f"timestamp,t_sec,t_nsec,{pose('p', 'q')}", "9,1,500000000,1,2,3,0,0,0,1"),
        (f"sec,nanosec,header.stamp.sec,header.stamp.nanosec,{pose('p', 'q')}", "9,9,1,500000000,1,2,3,0,0,0,1"),
    ],
)
def test_columns_that_belong_to_no_second_pose_are_left_aside(tmp_path, header, line):
    read = read_trajectory(written(tmp_path, f"{header}\n{line}\n".encode()))
    assert read.stamps_ns.tolist() == [1_500_000_000]
    np.testing.assert_array_equal(np.hstack([read.positions, read.quaternions]), [[1, 2, 3, 0, 0, 0, 1]])


@pytest.mark.parametrize("topic", ["error_state_kf", "sd_slam", "var/vio"])
@pytest.mark.parametrize("comment", ["", "# "])
def test_a_topic_may_be_called_as_a_spread(tmp_path, topic, comment):
    read = read_trajectory(written(tmp_path, f"{comment}__time,{plotted(topic)}\n1.5,1,2,3,0.6,0,0,0.8\n".encode()))
    np.testing.assert_array_equal(np.hstack([read.positions, read.quaternions]), [[1, 2, 3, 0.6, 0, 0, 0.8]])


@pytest.mark.parametrize(
    "header",
    [
        pose("p_std", "q"),
        pose("p_sigma_map", "q_sigma_map"),
        pose("sigma_p", "sigma_q"),
        pose("est", "q") + ",pos_std_x",
        pose("est", "q") + ",pos_sd_x,pos_sd_y,pos_sd_z",
        pose("utm", "q") + ",std_dev_px,std_dev_py,std_dev_pz",
        pose("map", "q") + ",error.pose.position.x,error.pose.position.y,error.pose.position.z",
        pose("est", "est_q") + "," + pose("sd_p", "sd_q"),
        pose("est", "q") + "," + pose("std_enu_p", "std_enu_q"),
    ],
)
def test_the_spread_of_a_position_is_no_position(tmp_path, header):
    line = ",".join(["0.5"] * (1 + len(header.split(","))))
    with pytest.raises(TrajectoryError, match="expected a header that names a column for each of t, x, y, z"):
        read_trajectory(written(tmp_path, f"t,{header}\n{line}\n".encode()))


@pytest.mark.parametrize("topic", ["std_slam", "variance_filter", "sigma", "vio/error"])
@pytest.mark.parametrize("comment", ["", "# "])
def test_where_a_word_of_a_spread_is_why_a_pose_is_refused_it_is_named(tmp_path, topic, comment):
    path = written(tmp_path, f"{comment}t,{plotted(topic)}\n1.5,1,2,3,0.6,0,0,0.8\n".encode())
    word = next(word for word in ("std", "variance", "sigma", "error") if word in topic)
    with pytest.raises(TrajectoryError, match=rf"where '{word}' in '/{topic}/pose/position/x' says .* \(rename it if"):
        read_trajectory(path)


@pytest.mark.parametrize("comment", ["", "# "])
@pytest.mark.parametrize(
    ("header", "line"),
    [
        ("timestamp,pose_x,pose_y,pose_z,qx,qy,qz,qw", "1,2,3,0.6,0,0,0.8"),
        ("timestamp,pose.qx,pose.qy,pose.qz,pose.qw,pose.x,pose.y,pose.z", "0.6,0,0,0.8,1,2,3"),
    ],
)
def test_a_position_may_be_called_pose(tmp_path, comment, header, line):
    read = read_trajectory(written(tmp_path, f"{comment}{header}\n1500000000000000000,{line}\n".encode()))
    np.testing.assert_array_equal(np.hstack([read.positions, read.quaternions]), [[1, 2, 3, 0.6, 0, 0, 0.8]])


@pytest.mark.parametrize(
    ("comment", "sign", "order"),
    [
        ("stamp,u,v,h,qx,qy,qz,qw", ",", "xyzw"),
        ("stamp,u,v,h,q_std_x,q_std_y,q_std_z,q_std_w", ",", "xyzw"),
        ("stamp u v h qw qx qy qz", " ", "wxyz"),
    ],
)
def test_a_comment_that_has_the_quaternion_elsewhere_than_the_layout_is_refused(tmp_path, comment, sign, order):
    """Though it does not name all other columns: in the order of the layout, the poses would be others."""
    row = sign.join(["1500000000", "1", "2", "3", "0.1", "0.7", "0.1", "0.7"])
    path = written(tmp_path, f"# {comment.replace(',', sign)}\n# of a dive\n{row}\n".encode())
    with pytest.raises(TrajectoryError, match=r"expected a comment that names .*--quaternion xyzw or wxyz\)"):
        read_trajectory(path)
    found = [[0.1, 0.7, 0.1, 0.7], [0.7, 0.1, 0.7, 0.1]]
    expected = found if order == "xyzw" else found[::-1]
    for k, asked in enumerate(("xyzw", "wxyz")):
        np.testing.assert_array_equal(read_trajectory(path, quaternion=asked).quaternions, [found[k]])
    layout = read_trajectory(path, format="euroc" if sign == "," else "tum")
    np.testing.assert_array_equal(layout.quaternions, expected[1:])
    other = comment.replace("u,v,h,", "u,v,h,w,").replace("u v h ", "u v h w ")
    more = written(tmp_path, f"# {other}\n{row}\n".encode())
    assert len(read_trajectory(more)) == 1, "a comment on other columns says nothing"


def test_an_order_that_is_asked_for_is_not_read_from_columns_that_a_comment_gives_to_others(tmp_path):
    path = written(tmp_path, b"# clock qx qy qz qw x y z\n1.5 0 0.6 0 0.8 0.01 0.6 0.03\n")
    for order in (None, "xyzw", "wxyz"):
        with pytest.raises(TrajectoryError, match=r"expected a comment that names .* got 'clock,qx,qy,qz,qw,x,y,z'"):
            read_trajectory(path, quaternion=order)
    assert len(read_trajectory(path, format="tum")) == 1


@pytest.mark.parametrize("names", ["timestamp_s,timestamp", "timestamp,timestamp_s"])
def test_of_two_columns_of_one_time_the_one_that_says_its_unit_is_read(tmp_path, names):
    """As in tables of PX4's logs, whose `timestamp` is in us."""
    stamps = {"timestamp_s": "12.5", "timestamp": "12500000"}
    line = ",".join(stamps[name] for name in names.split(","))
    path = written(tmp_path, f"{names},{pose('p', 'q')}\n{line},1,2,3,0,0,0,1\n".encode())
    for unit in (None, "s", "us"):
        assert read_trajectory(path, time_unit=unit).stamps_ns.tolist() == [12_500_000_000]


@pytest.mark.parametrize("unit", ["s", "ns"])
def test_the_unit_of_stamps_in_two_columns_is_not_asked_for(tmp_path, unit):
    path = written(tmp_path, f"stamp_sec,stamp_nsec,{pose('p', 'q')}\n1,500000000,1,2,3,0,0,0,1\n".encode())
    with pytest.raises(
        TrajectoryError, match=f"'stamp_sec' and 'stamp_nsec', of s and ns; leave --time-unit {unit} out"
    ):
        read_trajectory(path, time_unit=unit)
    assert read_trajectory(path).stamps_ns.tolist() == [1_500_000_000]


@pytest.mark.parametrize(("unit", "stamp"), [("s", 1_250_000_000), ("ns", 1_500_000_000)])
def test_of_stamps_in_two_units_the_one_that_is_asked_for_is_read(tmp_path, unit, stamp):
    path = written(tmp_path, f"stamp_sec,stamp_nsec,{pose('p', 'q')}\n1.25,1500000000,1,2,3,0,0,0,1\n".encode())
    assert read_trajectory(path, time_unit=unit).stamps_ns.tolist() == [stamp]


def test_a_unit_may_be_that_of_a_stamp_beside_a_time_in_two_columns(tmp_path):
    path = written(tmp_path, f"time_sec,time_nsec,stamp,{pose('p', 'q')}\n9,9,1500000000,1,2,3,0,0,0,1\n".encode())
    assert read_trajectory(path, time_unit="ns").stamps_ns.tolist() == [1_500_000_000]


def test_a_part_of_a_covariance_is_left_out_and_said(tmp_path):
    path = written(tmp_path, b"t,x,y,z,qx,qy,qz,qw,cov_x_x,cov_y_y\n1.5,1,2,3,0,0,0,1,4,5\n")
    trajectory = read_trajectory(path)
    assert trajectory.covariances is None
    assert trajectory.notes == ("poses.dat: its covariances are left out: 2 columns are not all of one",)


def test_the_upper_half_of_a_covariance_is_enough(tmp_path):
    axes = ("x", "y", "z", "rx", "ry", "rz")
    names = [f"cov_{a}_{b}" for i, a in enumerate(axes) for b in axes[i:]]
    values = ",".join(str(10 if a.split("_")[1] == a.split("_")[2] else 1) for a in names)
    text = f"t,x,y,z,qx,qy,qz,qw,{','.join(names)}\n1.5,1,2,3,0,0,0,1,{values}\n"
    covariances = read_trajectory(written(tmp_path, text.encode())).covariances
    np.testing.assert_array_equal(covariances, [9 * np.eye(6) + 1])


@pytest.mark.parametrize(
    "names",
    [
        "Time,header.seq,header.stamp.secs,header.stamp.nsecs",
        "index,n,header.stamp.sec,header.stamp.nanosec",
        "wall_time,n,sec,nanosec",
    ],
)
def test_a_timestamp_in_two_columns_is_read_from_both(tmp_path, names):
    header = f"{names},x,y,z,qx,qy,qz,qw\n"
    lines = [f"17.5,{k},1700000000,{k * 250_000_007},1,2,3,0,0,0,1" for k in range(4)]
    read = read_trajectory(written(tmp_path, (header + "\n".join(lines)).encode()))
    stamps = [1_700_000_000_000_000_000 + k * 250_000_007 for k in range(4)]
    assert read.stamps_ns.tolist() == stamps
    floats = [line.replace("1700000000", "1700000000.0") for line in lines]
    assert read_trajectory(written(tmp_path, (header + "\n".join(floats)).encode())).stamps_ns.tolist() == stamps


@pytest.mark.parametrize("order", [("timestamp_sec", "timestamp_nsec"), ("timestamp_nsec", "timestamp_sec")])
def test_two_timestamps_that_are_whole_each_are_no_parts_of_one(tmp_path, order):
    stamps = {"timestamp_sec": ["17.25", "17.5"], "timestamp_nsec": ["17250000000", "17500000000"]}
    lines = [",".join([*(stamps[name][k] for name in order), "1,2,3,0,0,0,1"]) for k in range(2)]
    text = "\n".join([",".join([*order, "x,y,z,qx,qy,qz,qw"]), *lines])
    assert read_trajectory(written(tmp_path, text.encode())).stamps_ns.tolist() == [17_250_000_000, 17_500_000_000]


@pytest.mark.parametrize(
    ("header", "line"),
    [
        (",timestamp,x,y,z,qx,qy,qz,qw", "0,1.5,1,2,3,0,0,0,1"),
        ("timestamp,x,y,z,qx,qy,qz,qw,", "1.5,1,2,3,0,0,0,1"),
        ("timestamp,x,y,z,qx,qy,qz,qw,", "1.5,1,2,3,0,0,0,1,"),
        ('"timestamp","x","y","z","qx","qy","qz","qw"', '"1.5","1","2","3","0","0","0","1"'),
    ],
)
def test_tables_as_other_programs_write_them_are_read(tmp_path, header, line):
    """An index without a name, a comma at the end, quotes."""
    read = read_trajectory(written(tmp_path, f"{header}\n{line}\n".encode()))
    assert (read.stamps_ns.tolist(), read.positions.tolist()) == ([1_500_000_000], [[1.0, 2.0, 3.0]])


@pytest.mark.parametrize(
    "text",
    [
        "t;x;y;z;qx;qy;qz;qw\n1,5;1,0;2,0;3,0;0,0;0,0;0,0;1,0\n",
        "1,5 1,0 2,0 3,0 0 0 0 1\n",
        "1,5;1,0;2,0;3,0;0;0;0;1\n",
    ],
)
def test_decimal_commas_are_named_as_such(tmp_path, text):
    with pytest.raises(TrajectoryError, match=r"expected numbers with decimal points, got decimal commas: '1,5"):
        read_trajectory(written(tmp_path, text.encode()))


def test_a_header_of_angles_is_refused_with_how_to_convert_them(tmp_path):
    with pytest.raises(TrajectoryError, match="got t, x, y, z, roll, pitch, yaw; convert it"):
        read_trajectory(written(tmp_path, b"t,x,y,z,roll,pitch,yaw\n1,0,0,0,0,0,1.2\n"))
