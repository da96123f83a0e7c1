"""Methods: found by name, run without the truth, failures named."""

from __future__ import annotations

import numpy as np
import pytest

import oysterbench
from oysterbench.errors import MethodError
from oysterbench.methods import Estimate, LandmarkMap, Method, find_method, method_names, run_method
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


# What an estimate may hold


STAMPS = np.arange(3, dtype=np.int64) * 10**9


def path(stamps=STAMPS, **changes):
    n = len(stamps)
    return Trajectory(
        stamps, **{"positions": np.zeros((n, 3)), "quaternions": np.tile([0.0, 0, 0, 1], (n, 1))} | changes
    )


def landmarks(**changes):
    values = {
        "keyframes": path(),
        "landmarks": np.zeros((2, 3)),
        "colours": np.zeros((2, 3), dtype=np.uint8),
        "observations": np.array([1, 2]),
    }
    return LandmarkMap(**values | changes)


@pytest.mark.parametrize(
    ("alternatives", "message"),
    [
        ({"online": path(positions=np.full((3, 3), np.nan))}, "alternative 'online': pose 1: expected finite numbers"),
        ({"online": path(STAMPS[::-1])}, "alternative 'online': pose 2: expected increasing stamps"),
        ({"online": path(STAMPS[:0])}, "alternative 'online': expected poses, got none"),
        ({"../online": path()}, "name of a path: expected letters, digits and _ -, got '../online'"),
        ({"optimised": path()}, "expected other names than that of the scored path, got 'optimised'"),
    ],
)
def test_a_further_path_that_is_none_is_named(alternatives, message):
    with pytest.raises(MethodError) as caught:
        Estimate(path(), scored="optimised", alternatives=alternatives)
    assert message in str(caught.value)
    assert Estimate(path(), scored="optimised", alternatives={"online": path()}).scored == "optimised"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"colours": np.zeros((1, 3), dtype=np.uint8)}, "map: expected colours (2, 3), got (1, 3)"),
        ({"colours": np.zeros((2, 3))}, "map: expected colours as uint8, got float64"),
        ({"observations": np.zeros(2)}, "map: expected observations as whole numbers, got float64"),
        ({"landmarks": np.array([[0.0, 0, 0], [0, np.inf, 0]])}, "map: expected finite landmarks, got"),
        ({"keyframes": path(STAMPS[::-1])}, "map: key frame 2: expected increasing stamps"),
    ],
)
def test_a_map_of_other_shapes_or_numbers_is_named(changes, message):
    with pytest.raises(MethodError) as caught:
        landmarks(**changes)
    assert message in str(caught.value)
    assert len(landmarks().landmarks) == 2
