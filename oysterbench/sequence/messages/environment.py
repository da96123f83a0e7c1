"""Messages of the pressure sensor and the magnetometer."""

from __future__ import annotations

import numpy as np

from oysterbench.core.measurements import MagneticMeasurement, PressureMeasurement
from oysterbench.sequence.names import (
    MAGNETOMETER,
    MAGNETOMETER_FRAME,
    MAGNETOMETER_TYPES,
    PRESSURE,
    PRESSURE_FRAME,
    PRESSURE_TYPES,
)
from oysterbench.sequence.wire import Message, decode, encode, header, make, stamp_of, vector


def pressure_message(sample: PressureMeasurement) -> Message:
    """Absolute pressure, Pa."""
    message = make(
        PRESSURE_TYPES[PRESSURE],
        header=header(sample.stamp_ns, PRESSURE_FRAME),
        fluid_pressure=float(sample.pressure),
        variance=float(sample.variance),
    )
    return Message(PRESSURE, sample.stamp_ns, encode(message))


def read_pressure(data: bytes) -> PressureMeasurement:
    """Pressure sample from its message."""
    message = decode(data, PRESSURE_TYPES[PRESSURE])
    return PressureMeasurement(stamp_of(message.header), float(message.fluid_pressure), float(message.variance))


def magnetic_message(sample: MagneticMeasurement) -> Message:
    """Magnetic field, T."""
    message = make(
        MAGNETOMETER_TYPES[MAGNETOMETER],
        header=header(sample.stamp_ns, MAGNETOMETER_FRAME),
        magnetic_field=vector(sample.field),
        magnetic_field_covariance=np.diag([float(sample.variance)] * 3).ravel(),
    )
    return Message(MAGNETOMETER, sample.stamp_ns, encode(message))


def read_magnetic(data: bytes) -> MagneticMeasurement:
    """Magnetic sample from its message."""
    message = decode(data, MAGNETOMETER_TYPES[MAGNETOMETER])
    field = message.magnetic_field
    return MagneticMeasurement(
        stamp_of(message.header), np.array([field.x, field.y, field.z]), float(message.magnetic_field_covariance[0])
    )
