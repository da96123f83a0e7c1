"""Paths thinned for drawing: on the truth's own stamps, aligned as scored, with gaps where nothing was answered."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import Trajectory, write_tum
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from oysterbench.results.records import ResultRecord, write_results
from oysterbench_leaderboard.publishing.folders import without_folders
from oysterbench_leaderboard.publishing.publish import Attribution, publish, records_of
from oysterbench_leaderboard.storage.curves import MOST_POINTS, curves_document, sequence_curve
from oysterbench_leaderboard.storage.store import RecordStore

EPOCH = 1_600_000_000_000_000_000


def loop(count: int = 4000, rate_hz: float = 100.0) -> Trajectory:
    """A round of 5 m radius that rises, with level attitudes turning along."""
    angle = np.linspace(0, 2 * np.pi, count)
    positions = np.column_stack([5 * np.cos(angle), 5 * np.sin(angle), 0.1 * angle])
    quaternions = np.column_stack([0 * angle, 0 * angle, np.sin(angle / 2), np.cos(angle / 2)])
    return Trajectory(EPOCH + (np.arange(count) * 1e9 / rate_hz).astype(np.int64), positions, quaternions)


def moved(truth: Trajectory, by: Array, keep: slice = slice(None)) -> Trajectory:
    """The same path elsewhere, with a slow wave of 5 cm on it."""
    wave = 0.05 * np.sin(np.linspace(0, 9, len(truth)))[:, None] * np.array([0, 0, 1])
    return Trajectory(truth.stamps_ns, truth.positions + by + wave, truth.quaternions).select(keep)


def test_points_lie_on_the_truths_stamps_aligned_as_scored():
    truth = loop()
    result = score(truth, moved(truth, np.array([7.0, -3.0, 1.0])), SlamSettings())
    curve = sequence_curve(result, 2)
    assert curve["run"] == 2
    assert len(curve["t_s"]) == len(curve["path"]) == len(curve["truth"]) == len(curve["error_m"]) == MOST_POINTS
    assert (curve["t_s"][0], curve["t_s"][-1]) == (0.0, 39.99)
    apart = np.linalg.norm(np.array(curve["path"]) - np.array(curve["truth"]), axis=1)
    np.testing.assert_allclose(apart, curve["error_m"], atol=3e-3)
    np.testing.assert_allclose(np.sqrt(np.mean(apart**2)), result.metrics["ate_rmse_m"], rtol=0.05)


def test_there_are_gaps_where_nothing_was_answered():
    truth = loop()
    half = moved(truth, np.zeros(3), slice(0, 2000))
    curve = sequence_curve(score(truth, half, SlamSettings()), 0)
    present = [point is not None for point in curve["path"]]
    assert present == [error is not None for error in curve["error_m"]]
    assert present == [t <= 19.991 for t in curve["t_s"]]


def test_a_short_path_is_kept_whole_and_a_curve_is_json():
    truth = loop(50, 10.0)
    curve = sequence_curve(score(truth, moved(truth, np.zeros(3)), SlamSettings()), 0)
    assert len(curve["t_s"]) == 50
    text = json.dumps(curves_document({"one": curve}, "posyaw"))
    assert "NaN" not in text
    assert "-0.0," not in text


def results_of(truth: Trajectory, estimate: Trajectory, evaluator: str = "slam 3") -> ResultRecord:
    settings = SlamSettings()
    metrics = score(truth, estimate, settings)
    return ResultRecord(
        track="slam",
        split="slam-mini",
        split_digest=recipe_digest(),
        sequence="mini-01",
        method="wave",
        metrics={**metrics.metrics, "wall_s": 3.0},
        reasons=metrics.reasons,
        settings=settings.as_dict(),
        evaluator_version=evaluator,
        info={"run": {"command": ["/opt/venv/bin/python3", "-m", "wave", "--out=/home/me/out.tum", "rate=1/2"]}},
        created="2026-11-20T12:00:00Z",
    )


def recipe_digest() -> str:
    from oysterbench.recipe import load_split
    from oysterbench.simulation.generate import digest

    return digest(load_split("slam-mini"))


def test_paths_beside_the_results_are_drawn_and_those_of_another_run_are_not(tmp_path):
    truth = loop()
    estimate = moved(truth, np.ones(3))
    write_results(tmp_path / "results.json", [results_of(truth, estimate)])
    notices: list[str] = []
    assert records_of(tmp_path, Attribution("x", "baseline"), notices.append)[0][1] is None
    write_tum(tmp_path / "mini-01-truth.tum", truth)
    write_tum(tmp_path / "mini-01-wave.tum", estimate)
    store = RecordStore(tmp_path / "board")
    ((record, _, new),) = publish(store, records_of(tmp_path, Attribution("x", "baseline"), notices.append))
    assert new
    assert set(store.curves(record.curves)["sequences"]) == {"mini-01"}
    assert notices == []
    write_tum(tmp_path / "mini-01-wave.tum", moved(truth, np.ones(3), slice(0, 3000)))
    assert records_of(tmp_path, Attribution("x", "baseline"), notices.append)[0][1] is None
    assert "another run" in notices[0]


def test_no_folder_of_the_machine_is_published():
    truth = loop(200, 10.0)
    told = "wrote no readable trajectory: /home/me/runs/mine/1/trajectory.tum:575: expected times that increase, m/s"
    failed = replace(results_of(truth, moved(truth, np.zeros(3))), failure=told)
    assert without_folders(failed).failure == told.replace("/home/me/runs/mine/1/", "")
    command = without_folders(results_of(truth, moved(truth, np.zeros(3)))).info["run"]["command"]
    assert command == ["python3", "-m", "wave", "--out=out.tum", "rate=1/2"]
