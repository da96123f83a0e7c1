"""The labels in a sequence file: the expert's, for evaluators and for learning, and hidden from methods."""

from __future__ import annotations

import io

import numpy as np
import pandas as pd
import pytest

import oysterbench
from oysterbench.core.errors import MethodError, RecipeError, SequenceError
from oysterbench.exploration.labelled_views import labelled_views
from oysterbench.recipe import load_split, parse_split
from oysterbench.render.camera import CameraRenderer
from oysterbench.sensors.camera import shown
from oysterbench.sequence.read import STEERING
from oysterbench.simulation.generate import generate_split
from oysterbench.simulation.sensor_simulation import sensor_kept
from oysterbench.simulation.simulated_sequence import build_sequence, forget_sequence
from oysterbench.simulation.steering.labels import steering_csv
from tests.helpers.exploring_made import RIG, made_split

MINI = load_split("steer-mini")
SHORT = MINI.source.replace("duration_s = 40.0", "duration_s = 4.0").replace("size_m = 12.0", "size_m = 11.0")


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    split = parse_split(SHORT, "short.toml")
    files = generate_split(split, tmp_path_factory.mktemp("split"), names=["mini-01"])
    return split, oysterbench.open(files["mini-01"])


def test_each_picture_has_a_label(sequence):
    _, opened = sequence
    table = opened.steering()
    assert table["stamp_ns"].tolist() == [image.stamp_ns for image in opened.images("cam_front")]
    values = table[[f"value_{y}_{p}" for y in range(7) for p in range(7)]].to_numpy()
    assert np.array_equal(values.argmax(axis=1), 7 * table["yaw"] + table["pitch"])
    truth = opened.truth()
    at = np.searchsorted(truth.stamps_ns, table["stamp_ns"])
    assert table["depth_m"].to_numpy() == pytest.approx(-truth.positions[at, 2], abs=1e-3)
    assert table["altitude_m"].between(0.3, 2.0).all()


def test_labels_are_the_same_wherever_they_are_made(sequence):
    split, opened = sequence
    forget_sequence()
    assert steering_csv(build_sequence(split, "mini-01", b""), split.steering) == opened.attachments[STEERING]


def test_a_method_does_not_see_them(sequence):
    with pytest.raises(MethodError, match="may not see the ground truth"):
        sequence[1].for_method().steering()


def test_a_file_without_labels_says_so(tiny_file):
    with pytest.raises(SequenceError, match=r"no ground truth about steering: no attachment truth/steering\.csv"):
        oysterbench.open(tiny_file).steering()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("yaw_deg = [30.0, 20.0", "yaw_deg = [20.0, 30.0", r"'steering\.yaw_deg': expected at least 3 falling"),
        ("-8.0, 0.0, 8.0", "-8.0, 8.0", r"'steering\.pitch_deg': expected at least 3 rising .* 0 among them"),
        ("altitude_m = [0.5, 1.4]", "altitude_m = [1.4, 0.5]", r"'steering\.altitude_m': expected the lowest"),
        ("rollout_s = 30.0", "rollout_s = 0.0", r"'steering\.rollout_s': expected 1 to 3600"),
        ('track = "steering"', 'track = "slam"', r"expected no table \[steering\] for track = 'slam'"),
    ],
)
def test_a_task_that_cannot_be_is_refused(old, new, message):
    assert SHORT.count(old) == 1
    with pytest.raises(RecipeError, match=message):
        parse_split(SHORT.replace(old, new), "short.toml")


def test_a_fence_that_leaves_no_room_is_refused():
    split = parse_split(SHORT.replace("rollout_s = 30.0", "rollout_s = 30.0\nfence_m = 5.0"), "short.toml")
    with pytest.raises(RecipeError, match=r"'steering\.fence_m': expected a fence that leaves"):
        steering_csv(build_sequence(split, "mini-01", b""), split.steering)


def test_the_expert_knows_of_a_repeated_picture_what_it_shows(monkeypatch):
    """And that of a picture that was lost, too, where it is repeated."""
    times: list[float] = []
    truth = CameraRenderer.truth
    monkeypatch.setattr(
        CameraRenderer, "truth", lambda self, pose, time_s=0.0: times.append(time_s) or truth(self, pose, time_s)
    )
    split = made_split(("one",), RIG.replace("\nrate_hz = 0.5\n", "\nrate_hz = 0.5\ndropout = 0.4\nrepeats = 0.5\n"))
    simulated = build_sequence(split, "one", b"")
    camera = simulated.rig.camera[0]
    own = np.arange(10)
    taken, kept = shown(simulated, camera), sensor_kept(simulated, camera, len(own))
    assert (taken[kept] != own[kept]).any()
    assert not kept[taken[kept]].all()
    table = pd.read_csv(io.BytesIO(steering_csv(simulated, split.steering)))
    assert times == (taken[kept] / camera.rate_hz).tolist()
    depths_m = [-body[2, 3] for body in simulated.bodies(own[kept] / camera.rate_hz)]
    assert table["depth_m"].tolist() == pytest.approx(depths_m, abs=1e-3)  # the state is of the label's own time


def test_a_picture_that_the_camera_lost_has_no_label_and_each_label_is_of_its_time(tmp_path, monkeypatch):
    times: list[float] = []
    truth = CameraRenderer.truth
    monkeypatch.setattr(
        CameraRenderer, "truth", lambda self, pose, time_s=0.0: times.append(time_s) or truth(self, pose, time_s)
    )
    lossy = RIG.replace("\nrate_hz = 0.5\n", "\nrate_hz = 0.5\ndropout = 0.4\n")
    split = made_split(("one",), lossy)
    views = labelled_views(generate_split(split, tmp_path, workers=1)["one"], split.steering)
    assert 0 < len(views.table) < 10
    shown = [view.time_s for view in views.views()]
    assert len(shown) == len(views.table)
    assert shown == pytest.approx([time_s - times[0] for time_s in times])
