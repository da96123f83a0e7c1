"""A system for a pair of cameras is not run with one, under a name that says two."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from importlib import import_module

import pytest
from scipy.spatial.transform import Rotation

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import transform
from oysterbench.methods.systems.manifest import split_reference
from tests.helpers.launches import launch_of

PAIRS = ["openvins_stereo", "orb_slam3_stereo_inertial", "okvis2", "vins_fusion", "basalt"]


def with_cameras(sequence, count):
    found = copy(sequence)
    found.cameras = dict(list(sequence.cameras.items())[:count])
    return found


@pytest.mark.parametrize(
    ("method", "count", "told"),
    [
        *((method, 1, "expected a sequence with 2 cameras, got hand-made with cam_left;") for method in PAIRS),
        ("dso", 0, "expected a sequence with 1 camera, got hand-made with none;"),
    ],
)
def test_fewer_cameras_than_a_system_is_for_are_refused(method, count, told, dive_file, tmp_path):
    launch = launch_of(method, dive_file, tmp_path)
    launch.__dict__["sequence"] = with_cameras(oysterbench.open(dive_file), count)
    with pytest.raises(MethodError, match=f"^{method}: {told}"):
        import_module(f"{split_reference(method)[0].module}.configure").command(launch)


@pytest.mark.parametrize(("turn_deg", "apart_m"), [(65, 0.3), (0, 0.0)])
def test_two_cameras_that_are_no_pair_are_refused_by_name(turn_deg, apart_m, dive_file, tmp_path):
    launch, sequence = launch_of("basalt", dive_file, tmp_path), copy(oysterbench.open(dive_file))
    left = sequence.cameras["cam_left"]
    T = transform(Rotation.from_euler("x", turn_deg, degrees=True).as_matrix(), [apart_m, 0.0, 0.0])
    sequence.cameras = {"cam_left": left, "cam_down": replace(left, T_base_cam=left.T_base_cam @ T)}
    launch.__dict__["sequence"] = sequence
    told = rf"^basalt: expected a stereo pair .* cam_left and cam_down, {turn_deg} deg and {100 * apart_m:.1f} cm apart"
    with pytest.raises(MethodError, match=told):
        _ = launch.cameras


@pytest.mark.parametrize(("method", "names"), [("openvins", ["cam_left"]), ("basalt", ["cam_left", "cam_right"])])
def test_a_system_gets_as_many_as_it_is_for(method, names, dive_file, tmp_path):
    assert list(launch_of(method, dive_file, tmp_path).cameras) == names
