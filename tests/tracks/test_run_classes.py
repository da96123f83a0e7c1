"""The runner with classes: each in a process of its own, seeded, and failing as a record."""

from __future__ import annotations

import os
import re
from dataclasses import replace

import pytest

from oysterbench.core.errors import MethodError
from oysterbench.core.ply import read_ply
from oysterbench.core.trajectory import read_trajectory
from oysterbench.methods.adapters import PythonMethod
from oysterbench.report.tables import results_table
from oysterbench.tracks import Request
from oysterbench.tracks.slam import TRACK

METHODS = """
import os
import numpy as np
from oysterbench.methods import Estimate, LandmarkMap
from oysterbench.core.trajectory import Trajectory


class Turns:
    name, track = "turns", "slam"

    def run(self, sequence):
        stamps = np.array([sample.stamp_ns for sample in sequence.imu()])
        t = (stamps - stamps[0]) * 1e-9
        positions = np.column_stack([np.sin(t), 1 - np.cos(t), 0 * t])
        return Estimate(Trajectory(stamps, positions, np.tile([0.0, 0, 0, 1], (len(stamps), 1))))


class Seeded(Turns):
    name, seed = "seeded", 40

    def run(self, sequence):
        estimate = super().run(sequence)
        return Estimate(estimate.trajectory, {"seed": self.seed, "noise": np.float32(0.5), "where": os.getpid()})


class Raises(Turns):
    name = "raises"

    def run(self, sequence):
        raise RuntimeError("out of ideas")


class Exits(Turns):
    name = "exits"

    def run(self, sequence):
        os._exit(9)


class Peeks(Turns):
    name = "peeks"

    def run(self, sequence):
        return Estimate(sequence.truth())


class Paths(Turns):
    name = "paths"

    def run(self, sequence):
        path = super().run(sequence).trajectory
        late = path.select(slice(len(path) // 2, None))
        late = Trajectory(late.stamps_ns, late.positions, late.quaternions, np.tile(np.eye(6), (len(late), 1, 1)))
        n = 4
        colours = np.tile(np.uint8([200, 100, 50]), (n, 1))
        seen = LandmarkMap(path.select(slice(None, None, 50)), np.eye(n)[:, :3], colours, np.arange(n))
        return Estimate(path, scored="optimised", alternatives={"online": late}, map=seen)


class Inherits(Turns):
    pass


class Other(Turns):
    track = "steering"


class Empty:
    pass
"""


@pytest.fixture
def own_methods(tmp_path, monkeypatch):
    (tmp_path / "own_methods.py").write_text(METHODS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))


def test_a_class_runs_in_a_process_of_its_own_with_the_seed_of_its_run(own_methods, run):
    runs = run(PythonMethod("own_methods:Seeded"), runs=2)
    assert [done.scored.record.seed for done in runs] == [40, 41]
    assert [done.scored.record.info["seed"] for done in runs] == [40, 41]
    assert runs[0].scored.record.info["noise"] == 0.5
    assert len({os.getpid(), *(done.scored.record.info["where"] for done in runs)}) == 3
    assert runs[0].scored.record.metrics["coverage"] > 0.9
    assert "numpy" in runs[0].scored.record.info["run"]["versions"]
    # The time of `run` counts, not that of Python's start; that is kept beside it.
    process = runs[0].outcome.process
    assert runs[0].outcome.wall_s < process["wall_s"]
    assert process["peak_bytes"] > 30e6


@pytest.mark.parametrize(
    ("name", "failure"),
    [
        ("Raises", "method 'raises' failed on hand-made: RuntimeError: out of ideas"),
        pytest.param("Exits", "method 'exits' on hand-made: exit status 9", marks=pytest.mark.slow),
        ("Peeks", "methods may not see the ground truth: Sequence.truth() is for evaluators"),
    ],
)
def test_a_class_that_fails_leaves_a_record_that_says_how(name, failure, own_methods, run):
    (done,) = run(PythonMethod(f"own_methods:{name}"))
    assert done.scored.record.failure == failure


def test_two_methods_of_one_name_are_refused_instead_of_averaged(own_methods, tmp_path):
    request = Request(out=tmp_path / "out", methods=("own_methods:Turns", "own_methods:Seeded", "own_methods:Inherits"))
    with pytest.raises(MethodError, match=r"^own_methods:Turns and own_methods:Inherits are both named 'turns': give"):
        TRACK.adapters(request)
    assert len(TRACK.adapters(replace(request, methods=request.methods[:2]))) == 2


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("own_methods:Absent", "own_methods.py has no 'Absent'"),
        ("own_methods:Empty", "expected an object with name, track and run"),
        ("own_methods:Other", "is of the track 'steering'; expected a method of 'slam'"),
        ("no_such_module:Slam", "cannot be loaded: No module named 'no_such_module'"),
        ("own_methods:", "expected module:Class, such as my_slam:MySlam"),
    ],
)
def test_a_class_that_cannot_be_had_is_named(reference, message, own_methods):
    with pytest.raises(MethodError) as caught:
        PythonMethod(reference)
    assert message in str(caught.value)


def test_further_paths_and_the_map_lie_beside_the_scored_path(own_methods, run, tmp_path):
    (done,) = run(PythonMethod("own_methods:Paths"))
    out = tmp_path / "out"
    scored, online = (read_trajectory(out / f"hand-made-paths{part}.tum") for part in ("", ".online"))
    assert len(online) == len(scored) - len(scored) // 2
    landmarks = read_ply(out / "hand-made-paths.map.ply")
    assert [landmarks[key].tolist() for key in ("x", "red", "observations")] == [[1, 0, 0, 0], [200] * 4, [0, 1, 2, 3]]
    assert len(read_trajectory(out / "runs/paths/hand-made/1/keyframes.tum")) == -(-len(scored) // 50)
    info = done.scored.record.info
    assert info["map"] == {"keyframes": -(-len(scored) // 50), "landmarks": 4}
    assert info["paths"]["scored"] == "optimised"
    assert info["paths"]["alternatives"]["online"]["coverage"] == pytest.approx(0.5, abs=0.02)
    assert done.scored.record.metrics["coverage"] > 0.9
    (message,) = results_table([done.scored.record]).notes
    assert "nees_position" not in done.scored.record.metrics
    assert 0.0 < info["paths"]["alternatives"]["online"]["nees_position"] < 3.0
    assert re.match(r"paths: the optimised path is scored; not scored: online \(ATE \S+ m, NEES of position ", message)
    # Of what is finished already, all of it is read again.
    (again,) = run(PythonMethod("own_methods:Paths"))
    assert again.scored.record.to_dict() == done.scored.record.to_dict()
