"""Columns that a header names: which are those of the pose beside its spreads, and how programs call them."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.trajectory import read_trajectory
from tests.core.test_trajectory_tables import echoed, plotted, pose
from tests.helpers.trajectory_files import written

WORDS = ["std", "sigma", "err", "error", "var", "cov", "sd", "std_dev"]
"""Words that columns of the spread of a pose have in their names."""


def spreads(word, position, quaternion):
    """Names of such columns, with the word before and after those of a pose."""
    return [pose(f"{word}_{position}", f"{word}_{quaternion}"), pose(f"{position}_{word}", f"{quaternion}_{word}")]


def read(tmp_path, header, line, **options):
    """The stamps and poses of a table of one line, (N,) and (N, 7)."""
    table = read_trajectory(written(tmp_path, f"{header}\n{line}\n".encode()), **options)
    return table.stamps_ns.tolist(), np.hstack([table.positions, table.quaternions])


@pytest.mark.parametrize("word", WORDS)
@pytest.mark.parametrize(
    ("position", "quaternion"),
    [("p_RS_R", "q_RS"), ("p_map", "q_map"), ("pos_enu", "quat_enu"), ("p_W", "q_WB"), ("vio_p", "vio_q"), ("p", "q")],
)
def test_spreads_stand_in_the_way_of_no_pose_wherever_their_word_stands(tmp_path, word, position, quaternion):
    plain = pose(position, quaternion)
    for spread in spreads(word, position, quaternion):
        for header, line in (
            (f"t,{plain},{spread}", "1.5,1,2,3,0,0,0,1" + ",9" * 7),
            (f"t,{spread},{plain}", "1.5" + ",9" * 7 + ",1,2,3,0,0,0,1"),
            (f"t,{','.join(spread.split(',')[:3])},{plain}", "1.5" + ",9" * 3 + ",1,2,3,0,0,0,1"),
        ):
            assert read(tmp_path, header, line)[0] == [1_500_000_000]
            np.testing.assert_array_equal(read(tmp_path, header, line)[1], [[1, 2, 3, 0, 0, 0, 1]])


@pytest.mark.parametrize("word", WORDS)
@pytest.mark.parametrize("beside", ["", "PosX,PosY,PosZ,QuatX,QuatY,QuatZ,QuatW,"])
@pytest.mark.parametrize(("position", "quaternion"), [("p_W", "q_W"), ("p_RS_R", "q_RS"), ("W_p", "W_q")])
def test_spreads_are_no_pose_wherever_their_word_stands(tmp_path, word, beside, position, quaternion):
    for spread in spreads(word, position, quaternion):
        line = ",".join(["0.5"] * (1 + len(f"{beside}{spread}".split(","))))
        with pytest.raises(
            TrajectoryError, match=r"expected a header .* says that it is a spread \(rename it if it is"
        ):
            read(tmp_path, f"t,{beside}{spread}", line)


def test_positions_alone_in_a_topic_called_as_a_spread_are_no_second_pose(tmp_path):
    header = f"t,{pose('odom.pose.position', 'odom.pose.orientation')},sigma_odom.pose.position_"
    line = "1.5,1,2,3,0,0,0,1,9,9,9"
    np.testing.assert_array_equal(
        read(tmp_path, ",sigma_odom.pose.position_".join([header + "x", "y", "z"]), line)[1], [[1, 2, 3, 0, 0, 0, 1]]
    )


def test_a_transform_may_be_of_a_topic_called_as_a_spread(tmp_path):
    moved = pose("/error_state_kf/transform/translation", "/error_state_kf/transform/rotation", "/")
    np.testing.assert_array_equal(read(tmp_path, f"t,{moved}", "1.5,1,2,3,0,0,0,1")[1], [[1, 2, 3, 0, 0, 0, 1]])
    with pytest.raises(TrajectoryError, match="which may be of several"):
        read(tmp_path, f"t,{moved},{plotted('gt')}", "1.5" + ",0.5" * 14)


TOPICS = [
    *("pose_with_covariance", "odom_cov", "err_state_kf", "/error_state_kf/odom", "dev", "/uncertainty_aware_slam"),
    *("/vio/pose_with_covariance", "pose_cov", "sigma_point_kf", "/attitude_estimator/odom/pose", "/q/pose/pose"),
    *("imu_orientation/odom", "/mavros/local_position"),
]
"""Names of whole poses that have words of a spread, an attitude or a position."""


@pytest.mark.parametrize("topic", TOPICS)
@pytest.mark.parametrize("sign", ["_", ".", "/"])
def test_words_in_the_name_of_a_whole_pose_are_of_the_name(tmp_path, topic, sign):
    """It is read, and beside another, in either order, neither is chosen without a word."""
    named = pose(f"{topic}{sign}position", f"{topic}{sign}orientation", sign)
    np.testing.assert_array_equal(read(tmp_path, f"t,{named}", "1.5,1,2,3,0.6,0,0,0.8")[1], [[1, 2, 3, 0.6, 0, 0, 0.8]])
    truth = pose(f"gt{sign}position", f"gt{sign}orientation", sign)
    for one, other in ((named, truth), (truth, named)):
        first, second = one.split(",")[0], other.split(",")[0]
        with pytest.raises(TrajectoryError, match=f"got '{first}' and '{second}', which may be of several"):
            read(tmp_path, f"t,{one},{other}", "1.5" + ",0.5" * 14)


@pytest.mark.parametrize("spread", ["err_position", "position_cov", "sigma_p_W", "Position Uncertainty", "p_W_std"])
def test_whole_spreads_of_a_name_that_is_not_the_poses_are_no_pose(tmp_path, spread):
    """Where the word stands beside the field."""
    attitude = spread.replace("position", "orientation").replace("Position", "Quaternion").replace("p_", "q_")
    header = f"t,{pose(spread, attitude)},{pose('vio_p', 'vio_q')}"
    line = "1.5" + ",9" * 7 + ",1,2,3,0,0,0,1"
    np.testing.assert_array_equal(read(tmp_path, header, line)[1], [[1, 2, 3, 0, 0, 0, 1]])
    with pytest.raises(TrajectoryError, match="says that it is a spread"):
        read(tmp_path, f"t,{pose(spread, attitude)}", "1.5,1,2,3,0,0,0,1")


def test_a_stamp_is_that_of_the_poses_topic_also_where_that_has_a_word_of_an_attitude(tmp_path):
    header = f"__time,/attitude/odom/header/stamp,{plotted('attitude/odom/pose')}"
    assert read(tmp_path, header, "9.5,1.5,1,2,3,0,0,0,1")[0] == [1_500_000_000]


def test_a_letter_behind_a_word_of_an_attitude_is_of_a_frame(tmp_path):
    header = f"t,{pose('p_T', 'q_T')}"
    np.testing.assert_array_equal(read(tmp_path, header, "1.5,1,2,3,0.6,0,0,0.8")[1], [[1, 2, 3, 0.6, 0, 0, 0.8]])


ROS = pose("pose.pose.position", "pose.pose.orientation", ".")
ECHOED = pose("field.pose.pose.position", "field.pose.pose.orientation", ".")
EUROC = "p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"


@pytest.mark.parametrize("sign", ["", "#", "# "])
@pytest.mark.parametrize(
    ("header", "line"),
    [
        ("timestamp tx ty tz qx qy qz qw", "1.5 1 2 3 0.6 0 0 0.8"),  # TUM, evo, ORB-SLAM3
        ("timestamp(s) tx ty tz qx qy qz qw Pr11 Pr12 Pr13 Pt11", "1.5 1 2 3 0.6 0 0 0.8 9 9 9 9"),  # OpenVINS
        ("timestamp(s),tx,ty,tz,qx,qy,qz,qw", "1.5,1,2,3,0.6,0,0,0.8"),
        ("timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z,v_x,v_y,v_z", "1500000000000000000,1,2,3,0.8,0.6,0,0,9,9,9"),  # VINS
        (
            f"timestamp,{EUROC},v_RS_R_x [m s^-1],b_w_RS_S_x [rad s^-1],b_a_RS_S_x [m s^-2]",
            "1500000000000000000,1,2,3,0.8,0.6,0,0,9,9,9",
        ),
        (
            f"%time,field.header.seq,field.header.stamp,field.header.frame_id,{ECHOED}"
            ",field.pose.covariance0,field.twist.twist.linear.x",
            "1500000000900000000,4,1500000000000000000,map,1,2,3,0.6,0,0,0.8,0.1,9",  # rostopic echo -p
        ),
        (
            f"header.stamp.sec,header.stamp.nanosec,header.frame_id,child_frame_id,{ROS},pose.covariance_0",
            "1500000000,0,map,base,1,2,3,0.6,0,0,0.8,0.1",  # ros2 topic echo --csv, with names
        ),
        (
            f"Time,header.seq,header.stamp.secs,header.stamp.nsecs,{ROS}",
            "9,4,1500000000,0,1,2,3,0.6,0,0,0.8",
        ),
        (
            f"__time,/odom/header/stamp,{plotted('odom/pose')},/odom/pose/covariance/[0;0]",
            "9,1500000000,1,2,3,0.6,0,0,0.8,0.1",  # PlotJuggler
        ),
        (f"__time,{plotted('mavros/local_position')}", "1500000000,1,2,3,0.6,0,0,0.8"),
        (f"__time,{plotted('zed/pose_with_covariance/pose')}", "1500000000,1,2,3,0.6,0,0,0.8"),
        (f"%time,{echoed(0)}", "1500000000000000000,1,2,3,0.6,0,0,0.8"),
        (f"__time,{plotted('mavros/vision_pose/pose_cov/pose')}", "1500000000,1,2,3,0.6,0,0,0.8"),
    ],
)
def test_tables_of_programs_in_wide_use_are_read(tmp_path, sign, header, line):
    stamps, poses = read(tmp_path, f"{sign}{header}", line)
    assert stamps[0] in (1_500_000_000, 1_500_000_000_000_000_000)
    np.testing.assert_array_equal(poses, [[1, 2, 3, 0.6, 0, 0, 0.8]])


@pytest.mark.parametrize("parts", ["", "/sec"])
def test_the_stamp_of_a_message_about_the_attitude_is_not_that_of_the_poses(tmp_path, parts):
    """Of one that is beside them, or on the same vehicle."""
    header = f"__time,/attitude/header/stamp{parts},/auv/attitude/header/stamp{parts},/auv/odom/header/stamp{parts}"
    columns = f"{header},{plotted('auv/odom/pose')}"
    assert read(tmp_path, columns, "9,7.5,8.5,1.5,1,2,3,0,0,0,1")[0] == [1_500_000_000]


@pytest.mark.parametrize(
    "header",
    [
        f"t,gt_x,gt_y,gt_z,gt_qx,gt_qy,gt_qz,gt_qw,{plotted('pose_with_covariance')}",
        f"t,est_x,est_y,est_z,est_qx,est_qy,est_qz,est_qw,{pose('cov_position', 'cov_orientation')}",
        f"t,{plotted('gt')},{plotted('pose_with_uncertainty')}",
        f"t,gt_x,gt_y,gt_z,gt_qx,gt_qy,gt_qz,gt_qw,{plotted('odom')}",
    ],
)
def test_a_pose_beside_another_quaternion_is_not_chosen_by_a_word_of_a_spread(tmp_path, header):
    with pytest.raises(TrajectoryError, match="which may be of several"):
        read(tmp_path, header, "1.5" + ",1,2,3,0,0,0,1" * 2)


@pytest.mark.parametrize("topic", ["odom", "mavros/local_position/pose_cov", "rov_dev/odom", "error_state_kf/odom"])
def test_a_pose_is_read_beside_the_orientation_of_an_inertial_unit(tmp_path, topic):
    imu = ",".join(f"/imu/data/{name}" for name in ("header/stamp", *(f"orientation/{axis}" for axis in "xyzw")))
    line = "9,1.5,1,2,3,0,0,0,1,8,0.6,0,0,0.8"
    stamps, poses = read(tmp_path, f"__time,/{topic}/header/stamp,{plotted(topic)},{imu}", line)
    assert stamps == [1_500_000_000]
    np.testing.assert_array_equal(poses, [[1, 2, 3, 0, 0, 0, 1]])


@pytest.mark.parametrize("names", ["t,T", "t [s],T [degC]", "t_s,T", "t (s),T (K)", "t,T [C]"])
def test_a_temperature_beside_the_time_is_no_time(tmp_path, names):
    time, temperature = names.split(",")
    header = f"{time},x,y,z,qx,qy,qz,qw,{temperature}"
    stamps, _ = read(tmp_path, header, "1.5,1,2,3,0,0,0,1,12.3", time_unit="s")
    assert stamps == [1_500_000_000]
