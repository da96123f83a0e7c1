"""A system for a pair of cameras is not run with one, under a name that says two."""

from __future__ import annotations

from copy import copy
from importlib import import_module

import pytest

import oysterbench
from oysterbench.core.errors import MethodError
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


@pytest.mark.parametrize(("method", "names"), [("openvins", ["cam_left"]), ("basalt", ["cam_left", "cam_right"])])
def test_a_system_gets_as_many_as_it_is_for(method, names, dive_file, tmp_path):
    assert list(launch_of(method, dive_file, tmp_path).cameras) == names
