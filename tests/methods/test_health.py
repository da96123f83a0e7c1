"""How each pose was had: what a method says of it, how that is kept, and what is measured of it."""

import dataclasses

import numpy as np
import pytest

from oysterbench.core.errors import MethodError
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from oysterbench.evaluate.slam.stretches import errors_by_state, states_at
from oysterbench.methods import Estimate, Health
from oysterbench.methods.health import NAMES, health_notes, read_health, write_health
from oysterbench.methods.interfaces.slam import keep, read_run_health
from oysterbench.report.consistency import consistency_table
from oysterbench.results.records import ResultRecord

STAMPS = np.arange(1, 101, dtype=np.int64) * 100_000_000


def path(error_m: np.ndarray | float = 0.0, sigma_m: float = 0.1) -> Trajectory:
    """10 m along x and 1 m to and fro along y, whose height errs."""
    x = np.linspace(0.0, 10.0, len(STAMPS))
    positions = np.column_stack([x, np.sin(x), np.zeros_like(x) + error_m])
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (len(STAMPS), 1))
    return Trajectory(STAMPS, positions, quaternions, np.tile(np.eye(6) * sigma_m**2, (len(STAMPS), 1, 1)))


def test_a_method_says_one_health_for_each_pose():
    with pytest.raises(MethodError, match=r"expected \(100,\) uint8, one for each pose, got \(99,\) uint8"):
        Estimate(path(), health=np.ones(99, dtype=np.uint8))
    with pytest.raises(MethodError, match="expected one of 0 coasting, 1 tracking, 2 relocalised, got 3 at pose 5"):
        Estimate(path(), health=np.where(np.arange(100) == 4, 3, 1).astype(np.uint8))


def test_what_is_kept_of_a_run_says_how_it_had_its_poses(tmp_path):
    health = np.repeat([1, 0, 2, 1], 25).astype(np.uint8)
    kept = keep(Estimate(path(), health=health), tmp_path)
    found = read_run_health(tmp_path, kept.prediction)
    assert found is not None
    np.testing.assert_array_equal(found[0], STAMPS)
    np.testing.assert_array_equal(found[1], health)


def test_a_method_that_says_nothing_leaves_nothing(tmp_path):
    kept = keep(Estimate(path()), tmp_path)
    assert read_run_health(tmp_path, kept.prediction) is None
    assert not list(tmp_path.glob("*.csv"))


def test_a_file_that_is_no_table_of_health_is_refused(tmp_path):
    file = tmp_path / "health.csv"
    write_health(file, STAMPS[:2], np.array([1, 0], dtype=np.uint8))
    file.write_text(file.read_text().replace("coasting", "asleep"))
    with pytest.raises(MethodError, match="expected a table of stamp_ns and health"):
        read_health(file)


def test_a_method_that_never_initialised_is_said_not_to_have(tmp_path):
    blind = np.zeros(len(STAMPS), dtype=np.uint8)
    (note,) = keep(Estimate(path(), {"initialised": 0}, health=blind), tmp_path).notes
    assert note.startswith(
        "never initialised: nothing that it saw is in its path, which by inertia alone is metres off"
    )
    assert keep(Estimate(path(), {"initialised": 1}), tmp_path).notes == []


def test_track_that_was_lost_for_a_second_or_more_after_the_start_is_told_of():
    health = np.repeat([0, 1, 0, 2, 0, 1, 0], [20, 20, 15, 5, 5, 10, 25]).astype(np.uint8)
    (note,) = health_notes({"initialised": 1}, STAMPS, health)
    assert note.startswith("lost track for 4.0 of 7.9 s, at most 2.5 s at a time: there its path is by inertia")
    assert health_notes({}, STAMPS, np.repeat([0, 1], 50).astype(np.uint8)) == []  # it coasts before its start alone
    assert health_notes({}, STAMPS, np.ones(100, dtype=np.uint8)) == []
    assert health_notes({}, STAMPS, np.zeros(100, dtype=np.uint8)) == []


def test_a_stamp_has_the_state_of_the_nearest_pose():
    states = states_at(STAMPS[:3], np.array([0, 1, 2], dtype=np.uint8), STAMPS[:3] + np.int64(30_000_000))
    np.testing.assert_array_equal(states, [0, 1, 2])
    late = states_at(STAMPS[:3], np.array([0, 1, 2], dtype=np.uint8), np.array([0, 10**10], dtype=np.int64))
    np.testing.assert_array_equal(late, [0, 2])
    np.testing.assert_array_equal(states_at(STAMPS[:1], np.array([2], dtype=np.uint8), STAMPS), np.full(100, 2))


def test_errors_are_told_apart_by_state():
    states = np.where(np.arange(100) < 75, Health.TRACKING, Health.COASTING).astype(np.uint8)
    wrong = np.where(states == Health.COASTING, 0.4, 0.0)
    result = score(path(), path(wrong), SlamSettings(align="none"))
    found = errors_by_state(result, states, NAMES)
    assert set(found) == {"tracking", "coasting"}
    assert found["tracking"]["share"] == pytest.approx(0.75)
    assert found["tracking"]["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert found["coasting"]["ate_rmse_m"] == pytest.approx(0.4)
    assert found["coasting"]["nees_position"] == pytest.approx(16.0)
    bare = errors_by_state(score(path(), dataclasses.replace(path(wrong), covariances=None)), states, NAMES)
    assert bare["coasting"]["nees_position"] is None


def test_the_report_has_a_row_for_each_run_that_says_how_sure_it_is():
    by_state = {"coasting": {"share": 0.25, "ate_rmse_m": 0.4, "nees_position": 16.0, "nees_rotation": None}}
    said = ResultRecord(
        track="slam",
        split="",
        sequence="a",
        method="mine",
        metrics={"nees_position": 4.0, "score": 0.5},
        info={"health": by_state},
    )
    bare = ResultRecord(track="slam", split="", sequence="a", method="mine", metrics={"score": 0.5})
    table = consistency_table([said, bare])
    assert table is not None
    assert len(table.rows) == 1
    texts = dict(zip([column.key for column in table.columns], table.texts[0], strict=True))
    assert texts["nees_position"] == "4.0"
    assert texts["coasting_share"] == "25.0"
    assert "tracking_share" not in texts  # a state that does not occur has no column
    assert consistency_table([bare]) is None
