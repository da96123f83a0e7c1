"""Grades of inertial units, and what a rig must say of its sensors."""

from __future__ import annotations

import re

import numpy as np
import pytest

from oysterbench.core.errors import RecipeError
from oysterbench.recipe import parse_split, vary_split
from oysterbench.sensors.imu import IMU_GRADES, ImuRecipe
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

NOISE_KEYS = ("gyro_noise_density", "gyro_random_walk", "accel_noise_density", "accel_random_walk")


def rig(imu, more=""):
    """A split whose rig has these lines in its [imu] and these after it."""
    bare = "\n".join(line for line in TINY_RIG.splitlines() if not line.startswith(("gyro", "accel")))
    return parse_split(
        TINY_SPLIT, "tiny.toml", rig_source=bare.replace("rate_hz = 100.0", f"rate_hz = 100.0\n{imu}") + more
    )


def test_a_grade_gives_the_keys_that_the_rig_does_not():
    unit = rig('grade = "low"\ngyro_noise_density = 1e-3').rig.of(ImuRecipe)[0]
    assert unit.gyro_noise_density == 1e-3
    assert unit.gyro_bias_instability == pytest.approx(np.radians(10.0) / 3600)
    assert (unit.accel_noise_density, unit.accel_bias_instability) == (pytest.approx(8.33e-4, rel=1e-3), 2.0e-4)
    assert (unit.accel_random_walk, unit.accel_bias_tau_s, unit.accel_range) == (0.0, 100.0, None)


def test_grades_are_as_published():
    # rad/s/sqrt(Hz) and m/s^2/sqrt(Hz), from deg/sqrt(h) and m/s/sqrt(h).
    published = {
        "low": (2.18e-4, 8.33e-4),
        "mid": (7.27e-5, 5.0e-4),
        "high": (5.82e-7, 4.17e-7),
        "mems": (6.98e-5, 9.81e-4),
    }
    assert set(published) == set(IMU_GRADES)
    for grade, (gyro, accel) in published.items():
        unit = rig(f'grade = "{grade}"').rig.of(ImuRecipe)[0]
        assert unit.gyro_noise_density == pytest.approx(gyro, rel=2e-3)
        assert unit.accel_noise_density == pytest.approx(accel, rel=2e-3)


def test_a_key_is_missing_only_when_neither_rig_nor_grade_gives_it():
    for key in NOISE_KEYS:
        others = "\n".join(f"{other} = 0.0" for other in NOISE_KEYS if other != key)
        with pytest.raises(RecipeError, match=f"missing key 'imu.{key}'"):
            rig(others)
        assert rig(others + '\ngrade = "mid"').rig.of(ImuRecipe)[0].grade == "mid"


def test_a_rig_with_a_grade_survives_being_taken_apart_and_built_again():
    split = rig('grade = "mems"\ngyro_step = 0.0\ngyro_turn_on = 0.02')
    assert vary_split(split, {}, "same").rig == split.rig
    assert rig('grade = "mems"').digest() != rig('grade = "low"').digest()
    assert rig('grade = "mems"').digest() != rig('grade = "mems"\ngyro_step = 0.0').digest()


def test_the_walk_of_a_bias_holds_its_instability():
    unit = rig('grade = "low"\naccel_random_walk = 3e-5').rig.of(ImuRecipe)[0]
    # A Gauss-Markov process steps by sigma * sqrt(2 dt / tau) while dt is short.
    assert unit.gyro_bias_walk == pytest.approx(np.radians(10.0) / 3600 * np.sqrt(2 / 100.0))
    assert unit.accel_bias_walk == pytest.approx(np.hypot(3e-5, 2e-4 * np.sqrt(2 / 100.0)))


@pytest.mark.parametrize(
    ("imu", "message"),
    [
        ('grade = "best"', r"key 'imu\.grade': expected one of low, mid, high, mems, got 'best'"),
        ("grade = 3", r"key 'imu\.grade': expected one of low, mid, high, mems, got 3"),
        ('grade = "low"\ndropout = 0.9', r"'imu\.dropout_burst': expected at least 9 for dropout = 0\.9, got 1"),
        (
            'grade = "low"\nvibration = [{on = "gyro", kind = "psd", psd = [[5.0, 1.0, 1.0, 1.0]]}]',
            r"'imu\.vibration\.psd': expected at least two rows of increasing frequency, got frequencies \[5\.0\]",
        ),
        (
            'grade = "low"\nvibration = [{on = "gyro", kind = "psd", psd = [[5, 1, 1, 1], [5, 0, 0, 0]]}]',
            r"expected at least two rows of increasing frequency, got frequencies \[5\.0, 5\.0\]",
        ),
        (
            'grade = "low"\nvibration = [{on = "gyro", kind = "sine", psd = [[5, 1, 1, 1], [6, 0, 0, 0]]}]',
            r"'imu\.vibration\.psd': expected none for kind = 'sine'; give level",
        ),
        (
            'grade = "low"\nvibration = [{on = "hull", kind = "sine"}]',
            r"'imu\.vibration\.on': expected one of accel, gyro, got 'hull'",
        ),
    ],
)
def test_a_bad_unit_is_named(imu, message):
    with pytest.raises(RecipeError) as caught:
        rig(imu)
    assert re.search(message, str(caught.value)), caught.value
    assert "\n" not in str(caught.value)


def test_losses_of_any_sensor_are_checked():
    for more in (
        "\ndropout = 0.8\n",
        "\n[pressure]\ndropout = 0.8\n",
        '\n[[altimeter]]\nname = "a"\nrate_hz = 5\ndropout = 0.8\n',
    ):
        with pytest.raises(RecipeError, match=r"dropout_burst': expected at least 4 for dropout = 0\.8, got 1"):
            rig('grade = "low"', more)
