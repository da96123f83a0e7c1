"""Messages of the Doppler velocity log: velocity, beams, altitude."""

from __future__ import annotations

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import DvlMeasurement
from oysterbench.sequence.messages.acoustic import ULTRASOUND
from oysterbench.sequence.messages.points import points_bytes, read_points
from oysterbench.sequence.names import DVL_ALTITUDE, DVL_BEAMS, DVL_FRAME, DVL_TYPES, DVL_VELOCITY, RANGE
from oysterbench.sequence.wire import Message, decode, encode, header, make, stamp_of, vector

BEAM = np.dtype(
    {
        "names": ["x", "y", "z", "range", "velocity", "valid"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<f4", "u1"],
        "offsets": [0, 4, 8, 12, 16, 20],
        "itemsize": 24,
    }
)
"""A beam as a point: where it meets the bottom in the DVL's frame (m), range (m) and velocity (m/s) along it, valid."""


def dvl_messages(sample: DvlMeasurement, min_range_m: float, max_range_m: float, janus_rad: float) -> list[Message]:
    """Velocity, beams and altitude of one sample; of the DVL, least and greatest range and beams off the vertical."""
    return [
        dvl_velocity_message(sample),
        dvl_beams_message(sample),
        dvl_altitude_message(sample, min_range_m, max_range_m, janus_rad),
    ]


def dvl_velocity_message(sample: DvlMeasurement) -> Message:
    """Velocity over ground with its covariance; rates are marked as not measured, by a variance of -1."""
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = sample.covariance
    covariance[3, 3] = -1.0
    twist = make("geometry_msgs/msg/Twist", linear=vector(sample.velocity), angular=vector(np.zeros(3)))
    message = make(
        DVL_TYPES[DVL_VELOCITY],
        header=header(sample.stamp_ns, DVL_FRAME),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance.ravel()),
    )
    return Message(DVL_VELOCITY, sample.stamp_ns, encode(message))


def dvl_beams_message(sample: DvlMeasurement) -> Message:
    """The beams, a point each; NaN where a beam has no lock."""
    rows = np.zeros(len(sample.beam_ranges), dtype=BEAM)
    hits = sample.beam_directions * np.asarray(sample.beam_ranges)[:, None]
    for axis, values in zip("xyz", hits.T, strict=True):
        rows[axis] = values
    rows["range"], rows["velocity"], rows["valid"] = sample.beam_ranges, sample.beam_velocities, sample.beam_valid
    return Message(DVL_BEAMS, sample.stamp_ns, points_bytes(sample.stamp_ns, DVL_FRAME, rows))


def dvl_altitude_message(sample: DvlMeasurement, min_range_m: float, max_range_m: float, janus_rad: float) -> Message:
    """Altitude along the DVL's -z, NaN without lock (REP 117); the field of view is what the beams span."""
    message = make(
        RANGE,
        header=header(sample.stamp_ns, DVL_FRAME),
        radiation_type=ULTRASOUND,
        field_of_view=2.0 * janus_rad,
        min_range=min_range_m,
        max_range=max_range_m,
        range=float(sample.altitude),
        variance=0.0,
    )
    return Message(DVL_ALTITUDE, sample.stamp_ns, encode(message))


def read_dvl(velocity: bytes, beams: bytes, altitude: bytes, directions: Array) -> DvlMeasurement:
    """Sample from its three messages and the beams' directions (4, 3), which the calibration keeps.

    Beams and altitude travel as float32; the figure of merit is the root of the covariance's trace. Raises ValueError
    where the messages are not of one stamp.
    """
    message = decode(velocity, DVL_TYPES[DVL_VELOCITY])
    stamp = stamp_of(message.header)
    beams_stamp, rows = read_points(beams)
    height = decode(altitude, RANGE)
    if not stamp == beams_stamp == stamp_of(height.header):
        raise ValueError(f"the DVL's velocity, beams and altitude at {stamp} are not of one stamp")
    linear = message.twist.twist.linear
    covariance = np.array(message.twist.covariance, dtype=float).reshape(6, 6)[:3, :3].copy()
    return DvlMeasurement(
        stamp_ns=stamp,
        velocity=np.array([linear.x, linear.y, linear.z]),
        covariance=covariance,
        figure_of_merit=float(np.sqrt(np.trace(covariance))),
        altitude=float(height.range),
        beam_directions=directions,
        beam_ranges=rows["range"].astype(float),
        beam_velocities=rows["velocity"].astype(float),
        beam_valid=rows["valid"].astype(bool),
    )
