"""Methods: found by name, run without the truth, failures named."""

from __future__ import annotations

import numpy as np
import pytest

import oysterbench
from oysterbench.errors import MethodError
from oysterbench.methods import Estimate, Method, find_method, method_names, run_method
from oysterbench.trajectory import Trajectory


class Still:
    """Stands still at the stamps of the first camera."""

    name = "still"
    track = "slam"

    def run(self, sequence):
        stamps = np.array([image.stamp_ns for image in sequence.images("cam_front")])
        return Estimate(Trajectory(stamps, np.zeros((len(stamps), 3)), np.tile([0.0, 0, 0, 1], (len(stamps), 1))))


class Raises(Still):
    def run(self, sequence):
        raise RuntimeError("out of ideas")


class Peeks(Still):
    def run(self, sequence):
        return Estimate(sequence.truth())


def test_the_baselines_are_installed_as_methods():
    assert {"gtsam_vi", "dead_reckoning"} <= set(method_names("slam"))
    for name in ("gtsam_vi", "dead_reckoning"):
        method = find_method(name)
        assert isinstance(method, Method)
        assert method.name == name


def test_an_unknown_method_is_named_with_what_is_installed():
    with pytest.raises(MethodError, match=r"unknown method 'orb_slam'; installed methods: .*gtsam_vi"):
        find_method("orb_slam")


def test_a_run_is_measured(tiny_file):
    run = run_method(Still(), oysterbench.open(tiny_file))
    assert len(run.estimate.trajectory) == 25
    assert run.wall_s > 0


def test_an_exception_of_a_method_becomes_one_line(tiny_file):
    with pytest.raises(MethodError, match="method 'still' failed on sequence tiny-01: RuntimeError: out of ideas"):
        run_method(Raises(), oysterbench.open(tiny_file))


def test_a_method_that_reaches_for_the_truth_is_stopped(tiny_file):
    with pytest.raises(MethodError, match="a method does not see the truth"):
        run_method(Peeks(), oysterbench.open(tiny_file))
