"""The score of two files, or of what is in memory: the evaluator's own numbers, and options by their names."""

from __future__ import annotations

import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import OptionError, TrajectoryError
from oysterbench.core.trajectory import Trajectory, write_tum
from oysterbench.evaluate.slam import SlamSettings
from oysterbench.evaluate.slam import score as score_poses
from oysterbench.sequence.export import export_sequence


@pytest.fixture(scope="module")
def truth(dive_file):
    return oysterbench.open(dive_file).truth()


@pytest.fixture(scope="module")
def estimate(truth):
    shaken = truth.positions + 0.01 * np.random.default_rng(3).normal(size=truth.positions.shape)
    return Trajectory(truth.stamps_ns[:80], shaken[:80], truth.quaternions[:80])


@pytest.fixture
def files(truth, estimate, tmp_path):
    write_tum(tmp_path / "a.tum", truth)
    write_tum(tmp_path / "b.tum", estimate)
    return tmp_path / "a.tum", tmp_path / "b.tum"


def test_files_and_memory_give_the_numbers_of_the_evaluator(truth, estimate, files):
    wanted = score_poses(truth, estimate, SlamSettings(align="origin")).metrics
    assert oysterbench.score(truth, estimate, align="origin").metrics == pytest.approx(
        wanted, rel=0, abs=0, nan_ok=True
    )
    assert oysterbench.score(*files, align="origin").metrics == pytest.approx(wanted, abs=1e-6, nan_ok=True)
    assert oysterbench.score(truth, files[1], align="origin").metrics == pytest.approx(wanted, abs=1e-6, nan_ok=True)


def test_a_sequence_or_its_file_is_its_truth(dive_file, truth, estimate):
    wanted = score_poses(truth, estimate).metrics["score"]
    assert oysterbench.score(dive_file, estimate).metrics["score"] == wanted
    assert oysterbench.score(str(dive_file), estimate).metrics["score"] == wanted
    assert oysterbench.score(oysterbench.open(dive_file), estimate).metrics["score"] == wanted


def test_a_folder_in_euroc_layout_is_its_truth(dive_file, truth, tmp_path):
    export_sequence(oysterbench.open(dive_file), "euroc", tmp_path / "euroc")
    euroc = oysterbench.open(tmp_path / "euroc").truth()
    assert oysterbench.score(tmp_path / "euroc", euroc).metrics["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("option", [{"unit": "mm"}, {"quaternion": "wxyz"}, {"truth_time_unit": "ms"}])
def test_how_a_file_is_read_is_refused_for_poses_in_memory(truth, estimate, files, dive_file, option):
    (name,) = option
    with pytest.raises(OptionError, match=f"{name}: it says how a file is read, and the .* is poses in memory"):
        oysterbench.score(truth, estimate, **option)
    if name.startswith("truth_"):
        with pytest.raises(OptionError, match=f"{name}: .* is a sequence, which says what its poses are"):
            oysterbench.score(dive_file, files[1], **option)


def test_defaults_of_reading_are_taken_for_poses_in_memory(truth, estimate):
    """A function that passes its own options on gives them whether or not there is a file."""
    result = oysterbench.score(truth, estimate, unit=None, sort=False, truth_T_body_estimate=None)
    assert result.metrics["coverage"] == pytest.approx(0.8)
    with pytest.raises(OptionError, match="sort: it says how a file is read"):
        oysterbench.score(truth, estimate, sort=True)


def test_numbers_are_plain(truth, estimate):
    result = oysterbench.score(truth, estimate)
    assert {type(value) for value in result.metrics.values()} <= {float, int}


def test_files_are_read_by_options_of_their_names(files, truth, estimate):
    thousandfold = Trajectory(estimate.stamps_ns, 1000 * estimate.positions, estimate.quaternions)
    write_tum(files[1], thousandfold)
    result = oysterbench.score(*files, unit="mm")
    assert result.metrics["ate_rmse_m"] < 0.02
    write_tum(files[0], Trajectory(truth.stamps_ns, 1000 * truth.positions, truth.quaternions))
    assert oysterbench.score(*files, unit="mm", truth_unit="mm").metrics["ate_rmse_m"] < 0.02


@pytest.mark.parametrize(
    ("options", "pattern"),
    [
        ({"alignment": "se3"}, "no option 'alignment'; did you mean align"),
        ({"truth_units": "mm"}, "no option 'truth_units'; did you mean truth_unit"),
    ],
)
def test_unknown_options_are_refused_with_those_there_are(truth, estimate, options, pattern):
    with pytest.raises(OptionError, match=pattern):
        oysterbench.score(truth, estimate, **options)


def test_what_cannot_be_scored_is_one_line(truth, tmp_path):
    with pytest.raises(TrajectoryError, match=r"gone.tum: no such file"):
        oysterbench.score(truth, tmp_path / "gone.tum")
    with pytest.raises(TrajectoryError, match="expected one of none, origin, se3"):
        oysterbench.score(truth, truth, align="sim4")


@pytest.mark.parametrize("role", ["truth", "estimate"])
def test_poses_of_another_kind_are_refused_with_what_is_expected(truth, role):
    given = {"truth": truth, "estimate": truth, role: np.zeros((5, 8))}
    with pytest.raises(TrajectoryError, match=rf"{role}: expected the path of a file, .*, got numpy\.ndarray"):
        oysterbench.score(given["truth"], given["estimate"])


def test_a_result_shows_itself(truth, estimate):
    result = oysterbench.score(truth, estimate)
    assert repr(result).startswith("<SlamResult: Score 0.")
    assert "Coverage 80 %" in repr(result)
    assert "\n" not in repr(result)
    page = result._repr_html_()
    assert "ATE" in page
    assert "Absolute trajectory error" in page
    table = result.summary()
    assert table.loc["ate_rmse_m", "unit"] == "m"
    assert table.loc["ate_rmse_m", "better"] == "lower"
    assert set(table.index) == set(result.metrics)
    missing = table[table["value"].isna()]
    assert (missing["reason"] != "").all()
    assert repr(truth) == "<Trajectory: 100 poses over 1.98 s and 0.792 m>"


def test_poses_in_lists_are_refused_with_what_makes_arrays_of_them():
    level = [[0.0, 0.0, 0.0, 1.0]] * 2
    with pytest.raises(TrajectoryError, match=r"^positions: expected a NumPy array, got list; numpy\.array"):
        oysterbench.Trajectory(np.array([0, 1]), [[0.0, 0, 0], [1, 0, 0]], level)
