"""Tables of inertial samples in EuRoC layout: what their columns and stamps say of their order and units."""

from __future__ import annotations

import re

import pytest

import oysterbench
from oysterbench.core.errors import SequenceError
from oysterbench.sequence.export.euroc import IMU_HEADER
from tests.helpers.euroc import FRAMES, SAMPLES, Folder

STAMPED = [
    *(("[us]", "us"), ("[milliseconds]", "ms"), ("[microseconds]", "us"), ("[\u00b5s]", "us")),
    *(
        ("(seconds)", "s"),
        ("[ticks]", "'ticks'"),
        ("[ms] (UTC)", "ms"),
        ("[1e-6 s]", "s"),
        ("[seconds since 1970]", "s"),
        ("[s since 1.6e9]", "s"),
        ("[s] (offset 1.6e9)", "s"),
        ("[usecs]", "us"),
        ("[msecs]", "ms"),
        ("[ns in 1 us steps]", "us"),
        ("_usecs", "us"),
        ("_us_utc", "us"),
        ("_us_since_boot", "us"),
        ("_ticks", "'ticks'"),
        ("_100ns", "'t _100ns'"),
    ),
    *(
        (f"[{said}]", f"'{said}'")
        for said in ("100 ns", "64 ns", "ns/100", "micro", "weeks", "MJD", "hh:mm:ss", "ksec", "count", "index")
    ),
]
"""What the name of a column says of stamps that are not in ns, and the unit."""
CLOCKS = [
    *("[ns] (UTC)", "(UTC)", "[unix]", "[epoch]", "[int64]", "(ROS)", "[TAI]", "[1e-9 s]", "[10^-9 s]", "[s*1e9]"),
    *("[10\u207b\u2079 s]", "[GPS ns]", "_ns (UTC)", "[ns since epoch]", "[Unix time]", "[nano]", "[uint64]"),
    *(
        "[ns since boot]",
        "[ns since 1970-01-01 00:00:00]",
        "[ns from epoch]",
        "[nano-seconds]",
        "[1 ns]",
        "[ns (system)]",
    ),
    *("[ns, device time]", "(imu) [ns]", "[ns] (global time)", "of week [ns]", "in nano seconds"),
    *("[ns] (leap seconds applied)", "[ns] (1 us resolution)", "[nanoseconds (1e-9 s)]", "[epoch 1970 ns]"),
]
"""What the name of a column says of stamps in ns: the clock, the type, or the unit in other words."""
DEGREES = ["deg_per_s", "deg_sec", "degps", "degree_per_second", "dps"]


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path / "dive")


@pytest.mark.parametrize(
    ("names", "what"),
    [
        ("timestamp,ax,ay,az,gx,gy,gz", "column 2 the x of the angular rate in rad/s, .*, got 'ax'"),
        ("#timestamp [ns],a_RS_S_x,a_RS_S_y,a_RS_S_z,w_RS_S_x,w_RS_S_y,w_RS_S_z", "column 2 .*, got 'a_RS_S_x'"),
        (
            "#timestamp [ns],w_x [deg s^-1],w_y [deg s^-1],w_z [deg s^-1],a_x,a_y,a_z",
            "column 2 .* in rad/s, .*, got 'w_x ",
        ),
        ("#timestamp [ns],w_x,w_y,w_z,a_x [g],a_y [g],a_z [g]", "column 5 the x of the specific force in m/s.2, "),
        ("t,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s,acc_x,acc_y,acc_z", "column 2 .*, got 'gyro_x_deg_s'"),
        ("t,gyro_z,gyro_y,gyro_x,accX,accY,accZ", "column 2 the x of the angular rate in rad/s, .*, got 'gyro_z'"),
        ("t,temperature,wx,wy,wz,ax,ay,az", "column 3 the y of the angular rate in rad/s, .*, got 'wx'"),
        *(
            (f"#t {said},w_x,w_y,w_z,a_x,a_y,a_z", f"stamps in ns, got {re.escape(unit)}, by the name 't ")
            for said, unit in STAMPED
        ),
        *((f"t,gyro_x_{unit},gyro_y,gyro_z,acc_x,acc_y,acc_z", "column 2 .*, got 'gyro_x_d") for unit in DEGREES),
        ("t,w_x,w_y,w_z,acc_x_cm_s2,acc_y_cm_s2,acc_z_cm_s2", "column 5 .*, got 'acc_x_cm_s2'"),
        ("t,gyro_rad[1],gyro_rad[0],gyro_rad[2],acc[0],acc[1],acc[2]", "column 2 the x .*, got 'gyro_rad"),
        ("t [ns, UTC];a_x [m/s^2];a_y;a_z;w_x [rad/s];w_y;w_z", "column 2 .*, got 'a_x "),
        ("t [ns, UTC]\ta_x\ta_y\ta_z\tw_x\tw_y\tw_z", "column 2 .*, got 'a_x'"),
        ("t,w_x,w_y,w_z,a_x,a_y,a_z (deg/s, m/s^2)", "column 7 .*, got 'a_z "),
        ("t,w_x,w_y,w_z,a_x,a_y,a_z (rad/s)", "column 7 .*, got 'a_z "),
        ("t,w_x,w_y,w_z,a_x,a_y,a_z [m/s^2, g]", "column 7 .*, got 'a_z "),
        ("t_us [ns],w_x,w_y,w_z,a_x,a_y,a_z", "stamps in ns, got us, by the name"),
        ("t [ns] (100 ns ticks),w_x,w_y,w_z,a_x,a_y,a_z", "stamps in ns, got '100 ns ticks', by the name"),
        ("t [us] (ns clock),w_x,w_y,w_z,a_x,a_y,a_z", "stamps in ns, got us, by the name"),
    ],
)
def test_inertial_columns_that_are_not_the_layouts_by_their_names_are_refused(folder, names, what):
    folder.change("imu0/data.csv", "#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z", names)
    with pytest.raises(SequenceError, match=f"imu0/data.csv: expected (in )?{what}"):
        oysterbench.open(folder.path)


@pytest.mark.parametrize(
    "names",
    [
        IMU_HEADER,
        "timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z",
        "t;gx (rad/s);gy (rad/s);gz (rad/s);accX (m/s\u00b2);accY (m/s\u00b2);accZ (m/s\u00b2);temperature [C]",
        "%time,field.angular_velocity.x,field.angular_velocity.y,field.angular_velocity.z,"
        "field.linear_acceleration.x,field.linear_acceleration.y,field.linear_acceleration.z",
        "t,w_x [radians/sec],w_y [rad s^-1],w_z [rad.s^-1],a_x [meters/s^2],a_y [m/sec^2],a_z [m per second squared]",
        "t,w_x,w_y,w_z,f_w_x,f_w_y,f_w_z",
        "t,gyro_x,gyro_y,gyro_z,specific_force_x,specific_force_y,specific_force_z",
        "t [nano seconds],gyro_x_rad_per_s,gyro_y_rad_per_s,gyro_z_rad_per_s,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2",
        "t [ns since 1970],gyro_rad[0],gyro_rad[1],gyro_rad[2],acc_m_s2[0],acc_m_s2[1],acc_m_s2[2]",
        "t [-],gyro_x_raw,gyro_y_raw,gyro_z_raw,acc_x,acc_y,acc_z",
        "timestamp [ns], w_x, w_y, w_z, a_x, a_y, a_z (rad/s, m/s^2)",
        "t (ns, UTC)\tw_x [rad/s]\tw_y [rad/s]\tw_z [rad/s]\ta_x [m/s^2]\ta_y [m/s^2]\ta_z [m/s^2]",
        "t;w_x [rad/s, FLU];w_y [rad/s, FLU];w_z [rad/s, FLU];a_x [m/s^2, FLU];a_y [m/s^2, FLU];a_z [m/s^2, FLU]",
        "# of a diver, in the bay",
        "timestamp,p,q,r,ax,ay,az,gyro_temp",
        "timestamp,p,q,r,ax,ay,az,gyro_std_x,gyro_std_y,gyro_std_z",
        "timestamp,roll_rate,pitch_rate,yaw_rate,acc_x,acc_y,acc_z,gyro2_x,gyro2_y,gyro2_z,acc2_x,acc2_y,acc2_z",
        "timestamp,gyro_roll,gyro_pitch,gyro_yaw,acc_x,acc_y,acc_z",
        "timestamp wx wy wz ax ay az dt_ms",
        "lever arm, x 0.1, y 0.0, z 0.2, yaw 90, pitch 0, roll 0",
        "Bosch BMI088, accel range 24 g, gyro range 2000 dps",
        "VN-100, gyro (bias removed), accel (bias removed)",
        "t, gyr [3x1], acc [3x1]",
        "t | gyro_x | gyro_y | gyro_z | acc_x | acc_y | acc_z",
        "timestamp, gyro(x,y,z), acc(x,y,z)",
        "t, w [rad/s], a [m/s^2]",
        "timestamp,rollrate,pitchrate,yawrate,ax,ay,az,x,y,z,w",
        "t,AngularRateX,AngularRateY,AngularRateZ,AccelX,AccelY,AccelZ,gyro_temp",
        "t,ang_vel_x,ang_vel_y,ang_vel_z,accl_x,accl_y,accl_z,gyro_bias_x,gyro_bias_y,gyro_bias_z",
        "t,Var2,Var3,Var4,Var5,Var6,Var7,gyro_temp",
        *(f"timestamp {said},w_x,w_y,w_z,a_x,a_y,a_z" for said in CLOCKS),
    ],
)
def test_inertial_columns_may_be_spelled_in_many_ways(folder, names):
    folder.change("imu0/data.csv", "#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z", f"# {names}")
    assert folder.read() == sorted(SAMPLES + FRAMES)


@pytest.mark.parametrize(
    "name",
    [
        "timestamp [UTC]",
        "t [unix]",
        "[int64] t",
        "timestamp",
        "timestamp [ns]",
        "timestampUs",
        "TimeUS",
        "t_micro",
        None,
    ],
)
@pytest.mark.parametrize(
    ("factor", "rates"),
    [(1000, "2e+05 Hz (200 Hz if they are in us)"), (10**6, "2e+08 Hz (200 Hz if they are in ms)")],
)
def test_inertial_stamps_in_another_unit_are_refused_whatever_their_name(folder, name, factor, rates):
    """By the rate of the samples, which no inertial unit has."""
    rows = "".join(f"{stamp // factor},0,0,0,0,0,9.8\n" for stamp in SAMPLES)
    folder.write("imu0/data.csv", (f"#{name},w_x,w_y,w_z,a_x,a_y,a_z\n" if name else "") + rows)
    wanted = (
        f"imu0/data.csv: expected inertial samples at up to 5000 Hz by their stamps in ns, got {rates}; convert the"
    )
    with pytest.raises(SequenceError, match=re.escape(wanted)):
        oysterbench.open(folder.path)


@pytest.mark.parametrize("step", [200_000, 10**9])
def test_inertial_samples_may_be_as_slow_and_as_fast_as_any(folder, step):
    """With gaps, and a few that are closer."""
    stamps = [10**18 + k * step for k in range(20) if k not in (5, 6, 7)] + [10**18 + 20 * step + 1]
    folder.write("imu0/data.csv", "".join(f"{stamp},0,0,0,0,0,9.8\n" for stamp in stamps))
    assert [sample.stamp_ns for sample in oysterbench.open(folder.path).imu()] == stamps
    folder.write("imu0/data.csv", f"{stamps[0]},0,0,0,0,0,9.8\n")
    assert len(list(oysterbench.open(folder.path).imu())) == 1


@pytest.mark.parametrize("begin", [0, 17 * 10**17])
@pytest.mark.parametrize(
    "stamp_ns",
    [
        lambda k: 16_000_000 * (k // 3) + 60_000 * (k % 3),  # of an adapter from USB to serial
        lambda k: 50_000_000 * (k // 10) + 20_000 * (k % 10),
        lambda k: 40_000_000 * (k // 8) + k % 8,
        lambda k: 5_000_000 * (k // 2) + 50_000 * (k % 2),  # rates and forces, each at its own stamps
        lambda k: 5_000_000 * k + 10**12 * (k > 3),
    ],
)
def test_inertial_samples_may_be_stamped_in_bursts_and_have_gaps(folder, begin, stamp_ns):
    rows = "".join(f"{begin + stamp_ns(k)},0,0,0,0,0,9.8\n" for k in range(200))
    folder.write("imu0/data.csv", rows)
    assert len(list(oysterbench.open(folder.path).imu())) == 200


@pytest.mark.parametrize("step", [31_250, 150_000, 100 * 10**9])
def test_inertial_samples_since_1970_may_be_at_any_rate(folder, step):
    """Stamps that large can only be in ns, unlike others, of which the way out is told, or the 100 ns of Windows."""
    rows = [",0,0,0,0,0,9.8\n"] * 20
    folder.write("imu0/data.csv", "".join(f"{17 * 10**17 + k * step}{row}" for k, row in enumerate(rows)))
    assert len(list(oysterbench.open(folder.path).imu())) == 20
    for begin in (0, 133 * 10**15, 638 * 10**15):
        folder.write("imu0/data.csv", "".join(f"{begin + k * step}{row}" for k, row in enumerate(rows)))
        if step > 10**9:  # too slow in any unit: a stand-in for none
            assert len(list(oysterbench.open(folder.path).imu())) == 20
        else:
            with pytest.raises(SequenceError, match="convert the stamps to ns or, if they are, write them as ns since"):
                oysterbench.open(folder.path)


@pytest.mark.parametrize("gap", [0, 60 * 10**6])
def test_inertial_stamps_in_us_are_refused_also_with_a_gap(folder, gap):
    folder.write("imu0/data.csv", "".join(f"{k * 5000 + gap * (k > 9)},0,0,0,0,0,9.8\n" for k in range(40)))
    with pytest.raises(SequenceError, match=r"2e\+05 Hz \(200 Hz if they are in us\)"):
        oysterbench.open(folder.path)


REMARK = "# IMU (VN-100) of the ROV, 200 Hz, gyro, accel, FLU, site A, 2024-05-01"
NAMES = "#timestamp [ns],wx,wy,wz,ax,ay,az"


@pytest.mark.parametrize(
    "above",
    [
        *(f"{REMARK}\n{NAMES}", f"{NAMES}\n{REMARK}", "# Copyright (c) 2024, A, B, C, D, E, F"),
        *("#Recorded by A. Smith,,,,,,\n#timestamp [ns],x,y,z,x,y,z", "#Dive A,,,,,,", "#IMU of ROV at site F,,,,,,"),
    ],
)
def test_a_remark_with_commas_names_no_columns(folder, above):
    samples = folder.root / "imu0" / "data.csv"
    text = samples.read_text().partition("\n")[2]
    samples.write_text(f"{above}\n{text}")
    assert len(list(oysterbench.open(folder.path).imu())) == len(SAMPLES)
    other = "#timestamp [ns],ax,ay,az,wx,wy,wz"
    samples.write_text(f"{above.replace(NAMES, other)}\n{other}\n{text}")
    with pytest.raises(SequenceError, match="expected in column 2 the x of the angular rate"):
        oysterbench.open(folder.path)


def test_units_in_a_line_of_their_own_are_those_of_the_columns(folder):
    samples = folder.root / "imu0" / "data.csv"
    text = samples.read_text().partition("\n")[2]
    samples.write_text(f"{NAMES}\n#[ns],[rad/s],[rad/s],[rad/s],[m/s^2],[m/s^2],[m/s^2]\n{text}")
    assert len(list(oysterbench.open(folder.path).imu())) == len(SAMPLES)
    samples.write_text(f"#timestamp,wx,wy,wz,ax,ay,az\n#[ns],[deg/s],[deg/s],[deg/s],[g],[g],[g]\n{text}")
    with pytest.raises(SequenceError, match=re.escape("got '[deg/s]' in line 2")):
        oysterbench.open(folder.path)


@pytest.mark.parametrize("frame", [" (FRD)", " [rad/s] (body)", " [rad/s; FLU]", " (body) [rad/s]"])
def test_a_frame_in_brackets_is_no_unit(folder, frame):
    samples = folder.root / "imu0" / "data.csv"
    text = samples.read_text().partition("\n")[2]
    names = ",".join(f"w_{axis}{frame}" for axis in "xyz") + "," + ",".join(f"a_{axis}" for axis in "xyz")
    samples.write_text(f"#timestamp [ns],{names}\n{text}")
    assert len(list(oysterbench.open(folder.path).imu())) == len(SAMPLES)


@pytest.mark.parametrize(
    "above",
    [
        "#timestamp,ax,ay,az,wx,wy,wz\n#ns,m/s^2,m/s^2,m/s^2,rad/s,rad/s,rad/s",
        "#timestamp,acc,acc,acc,gyro,gyro,gyro\n#,x,y,z,x,y,z",
        "SystemTime,AccX_mg,AccY_mg,AccZ_mg,GyroX_dps,GyroY_dps,GyroZ_dps",
        "#TimestampNs,gyro_x_dps,gyro_y_dps,gyro_z_dps,acc_x,acc_y,acc_z",
        "#Epoch,acc_z,acc_y,acc_x,gyro_z,gyro_y,gyro_x",
        "#utc,acc1,acc2,acc3,gyr1,gyr2,gyr3",
        "#[ns],[deg/s],[deg/s],[deg/s],[g],[g],[g]\n#timestamp,wx,wy,wz,ax,ay,az",
        "#ns,deg/s,deg/s,deg/s,g,g,g\n#timestamp,wx,wy,wz,ax,ay,az",
        "#timestamp [ns],acc,,,gyro,,\n#,x,y,z,x,y,z",
        "#,acc,,,gyro,,\n#timestamp [ns],x,y,z,x,y,z",
        "#[ns],[deg/s],[deg/s],[deg/s],[g],[g],[g]",
        "#[ns],[m/s^2],[m/s^2],[m/s^2],[rad/s],[rad/s],[rad/s]",
        "#timestamp,wx,wy,wz,ax,ay,az\n#[ns],[\u00b0/s],[\u00b0/s],[\u00b0/s],[m/s\u00b2],[m/s\u00b2],[m/s\u00b2]",
        "#timestamp,wx,wy,wz,ax,ay,az\n#ns;\u00b0/s;\u00b0/s;\u00b0/s;m/s\u00b2;m/s\u00b2;m/s\u00b2",
        "#timestamp,wx,wy,wz,ax,ay,az\n#[ns since boot],[deg/s],[deg/s],[deg/s],[g],[g],[g]",
        "#timestamp,wx,wy,wz,ax,ay,az\n#[int64],[LSB],[LSB],[LSB],[LSB],[LSB],[LSB]",
        "#timestamp,wx,wy,wz,ax,ay,az\n# Units: [ns],[deg/s],[deg/s],[deg/s],[g],[g],[g]",
        "#,,,,,,\n#timestamp,wx,wy,wz,ax,ay,az\n#[ns],[deg/s],[deg/s],[deg/s],[g],[g],[g]",
        "#timestamp,qx,qy,qz,qw,gx,gy,gz,ax,ay,az",
        "#timestamp,px,py,pz,qw,qx,qy,qz,gx,gy,gz,ax,ay,az",
        "#GpsTow,Yaw,Pitch,Roll,MagX,MagY,MagZ,AccelX,AccelY,AccelZ,GyroX,GyroY,GyroZ",
        "#time,gFx,gFy,gFz,ax,ay,az,wx,wy,wz",
        "#timestamp,temperature,pressure,depth,heading,gx,gy,gz,ax,ay,az",
        "#Time series of gyro and accelerometer,,,,,,\n#timestamp [ns],ax,ay,az,wx,wy,wz",
        "#,Acceleration,,,Rotation rate,,\n#Timestamp,X,Y,Z,X,Y,Z",
        "#,Gyroscope [deg/s],,,Accelerometer [g],,\n#Timestamp,X,Y,Z,X,Y,Z",
        "#timestamp [ns],wx,wy,wz,ax,ay,az\n# converted from t,acc_x,acc_y,acc_z,gyro_x,gyro_y,gyro_z",
        "#timestamp,a,a,a,w,w,w",
        "#,Gyroscope,,,Accelerometer,,\n#Timestamp,Z,Y,X,Z,Y,X",
        "#,Gyroscope,,,Accelerometer,,\n#Timestamp [ns],X [deg/s],Y [deg/s],Z [deg/s],X,Y,Z",
        "#timestamp,accel_x,accel_y,accel_z,p,q,r\n#[ns],[rad/s],[rad/s],[rad/s],[m/s^2],[m/s^2],[m/s^2]",
        "#timestamp,wx,wy,wz,ax,ay,az\n#ns,deg/s,deg/s,deg/s,cm/s^2,cm/s^2,cm/s^2",
        '#timestamp,wx,wy,wz,ax,ay,az\n#"ns","deg/s","deg/s","deg/s","g","g","g"',
        "#timestamp,wx,wy,wz,ax,ay,az\n#ns,mrad/s,mrad/s,mrad/s,mg,mg,mg",
        "#timestamp,mag_x,mag_y,mag_z,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z",
        "timestamp,mag,mag.1,mag.2,acc,acc.1,acc.2,gyro,gyro.1,gyro.2",
        "#,Magnetometer,,,Accelerometer,,,Gyroscope,,\n#t,x,y,z,x,y,z,x,y,z",
        "Time,LinearAccelerationX,LinearAccelerationY,LinearAccelerationZ,AngularVelocityX,AngularVelocityY,c",
        "Time,LinearAcceleration_1,LinearAcceleration_2,LinearAcceleration_3,AngularVelocity_1,b,c",
        "timestamp,xacc,yacc,zacc,xgyro,ygyro,zgyro",
        "# timestamp ax ay az wx wy wz",
        "# t | acc_x | acc_y | acc_z | gyro_x | gyro_y | gyro_z",
        "#timestamp, a [m/s^2], w [rad/s]",
        "#timestamp,acc[3],gyro[3]",
        "# timestamp [ns] ax [m/s^2] ay [m/s^2] az [m/s^2] wx [rad/s] wy [rad/s] wz [rad/s]",
        "#t,roll_rate_deg_s,pitch_rate_deg_s,yaw_rate_deg_s,acc_x,acc_y,acc_z",
        "#timestamp,yaw_rate,pitch_rate,roll_rate,acc_x,acc_y,acc_z",
        "#timestamp,r,q,p,ax,ay,az",
        "#timestamp,gyro_x,gyro_y,gyro_z,linear_velocity_x,linear_velocity_y,linear_velocity_z",
        "#timestamp,angular_acceleration_x,angular_acceleration_y,angular_acceleration_z,acc_x,acc_y,acc_z",
        "#timestamp,roll,pitch,yaw,rollspeed,pitchspeed,yawspeed",
    ],
)
def test_names_and_units_of_another_order_or_unit_are_refused_wherever_they_stand(folder, above):
    samples = folder.root / "imu0" / "data.csv"
    samples.write_text(f"{above}\n{samples.read_text().partition(chr(10))[2]}")
    with pytest.raises(SequenceError, match=r"expected in column \d the [xyz] of the (angular rate|specific force)"):
        oysterbench.open(folder.path)


@pytest.mark.parametrize(
    "below",
    [
        "#(int64),(float64),(float64),(float64),(float64),(float64),(float64)",
        "#(1),(2),(3),(4),(5),(6),(7)",
        "#0,1,2,3,4,5,6",
        "#<i8,<f8,<f8,<f8,<f8,<f8,<f8",
        "#%d,%.9f,%.9f,%.9f,%.9f,%.9f,%.9f",
        "# time offset to cam0: 0.003 s, gyro, accel, FLU, site A, B, C",
        "# of dive 3,,,,,,",
        "#,,,,,,",
        "# A. Smith, with G, W and A, F, W, site B, 2024, at 2 m, 7 C",
    ],
)
def test_types_numbers_and_remarks_below_the_names_say_no_units(folder, below):
    samples = folder.root / "imu0" / "data.csv"
    samples.write_text(f"{NAMES}\n{below}\n{samples.read_text().partition(chr(10))[2]}")
    assert len(list(oysterbench.open(folder.path).imu())) == len(SAMPLES)
