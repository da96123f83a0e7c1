"""The track steering, run: methods over labelled pictures, and what reports show of them."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from oysterbench.core.errors import LabelError, MethodError
from oysterbench.evaluate.statistics import Comparison, Interval
from oysterbench.evaluate.steering import failed_metrics
from oysterbench.exploration.labelled_views import labelled_views
from oysterbench.methods.interfaces import Stopwatch
from oysterbench.methods.interfaces.steering import COMMANDS, read_classes
from oysterbench.report import exploring
from oysterbench.report.exploring import places, places_table, policies_table, whole_of
from oysterbench.report.steering_samples import bow_pixels, samples_of
from oysterbench.results.records import ResultRecord
from oysterbench.tracks.steering import TRACK, ViewSequence
from oysterbench.tracks.steering_rollouts import REFERENCES, plan_rollouts, run_rollouts
from tests.helpers import exploring_policies
from tests.helpers.exploring_made import label_table, made_explore, made_split, write_labelled
from tests.helpers.track_runs import runs_of

SPLIT = made_split()

POLICIES = "tests.helpers.exploring_policies"


def evaluate(sequences, methods, out):
    """Runs of policies: names, or classes of POLICIES, over labelled pictures."""
    references = [f"{POLICIES}:{name}" if name[0].isupper() else name for name in methods]
    labelled = [ViewSequence(views, views.sequence.path, SPLIT) for views in sequences]
    return runs_of(TRACK, labelled, references, None, out)


@pytest.fixture(scope="module")
def sequences(tmp_path_factory):
    """Two labelled sequences."""
    folder = tmp_path_factory.mktemp("labelled")
    return [
        labelled_views(write_labelled(folder / f"{name}.mcap", name, label_table(n, seed)), SPLIT.steering)
        for name, n, seed in (("one", 9, 1), ("two", 7, 2))
    ]


def test_views_come_in_time_order_with_the_state_of_their_label(sequences):
    table = label_table(9, 1)
    labelled = sequences[0]
    views = list(labelled.views())
    assert [view.name for view in views] == [f"one/cam_front/{stamp}" for stamp in table["stamp_ns"]]
    assert [view.state.heading for view in views] == table["heading_rad"].tolist()
    assert [view.state.pitch for view in views] == table["pitch_rad"].tolist()
    assert [view.time_s for view in views] == [2.0 * k for k in range(9)]
    assert views[0].state.depth == 2.0
    assert views[0].state.altitude == 1.0
    assert views[0].pixels.shape == (24, 32, 3)
    assert labelled.labels.action_values[4, 2, 5] == table["value_2_5"][4]
    assert (labelled.labels.classes == table[["yaw", "pitch"]].to_numpy()).all()


@pytest.mark.slow
def test_a_method_that_reads_the_expert_off_the_pictures_is_right_in_all(sequences, tmp_path):
    runs = evaluate(sequences, ["Reader", "Unsure"], tmp_path)
    for run in runs:
        assert run.record.failure is None
        metrics = run.record.metrics
        assert metrics["skill"] == metrics["yaw_macro_f1"] == metrics["pitch_macro_f1"] == 1
        assert metrics["joint_accuracy"] == metrics["yaw_within_one"] == metrics["pitch_accuracy"] == 1
        assert metrics["regret_oysters"] == 0
        assert metrics["pictures"] == {"one": 9, "two": 7}[run.record.sequence]
        assert metrics["pictures_per_s"] > 0
        assert (run.record.track, run.record.split, run.record.evaluator_version) == (
            "steering",
            "made",
            "navigation 1",
        )
        assert ResultRecord.from_dict(json.loads(run.record.to_json())) == run.record
    costs = {(run.record.method, run.record.sequence): run.record.metrics["yaw_cost_classes"] for run in runs}
    assert costs["reader", "one"] == 0
    classes = label_table(9, 1)["yaw"]
    spread = np.mean([np.abs(np.arange(7) - c).sum() / 14 for c in classes])
    assert costs["unsure", "one"] == pytest.approx(spread)  # half of it on the right one, half on all alike


@pytest.mark.slow
def test_straight_and_chance_are_the_floor(sequences, tmp_path):
    runs = evaluate(sequences, ["straight", "chance"], tmp_path)
    assert {run.record.method: run.record.seed for run in runs} == {"straight": None, "chance": 0}
    straight, chance = runs[:2]
    assert (straight.commands.classes == 3).all()
    again = evaluate(sequences, ["chance"], tmp_path)[0]
    assert (again.commands.classes == chance.commands.classes).all()
    other = evaluate(sequences, ["chance[seed=1]"], tmp_path)[0]
    assert (other.commands.classes != chance.commands.classes).any()
    assert len(set(map(tuple, chance.commands.classes.tolist()))) > 4


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ("Ahead", "requested another view before giving a command at one/cam_front"),
        pytest.param("Wrong", "expected a Steering of the view one/cam_front", marks=pytest.mark.slow),
        pytest.param("Short", "expected 9 commands, one for each view, got 1", marks=pytest.mark.slow),
        ("Broken", "ValueError: no such weight"),
        pytest.param("Few", "yaw_probability: expected 7 numbers", marks=pytest.mark.slow),
        pytest.param("NotNumbers", "pitch_probability: expected 7 numbers", marks=pytest.mark.slow),
        pytest.param("Negative", "pitch_probability: expected 7 numbers, none below 0", marks=pytest.mark.slow),
        ("Outside", "yaw: expected a class from 0 to 6, got 7"),
    ],
)
def test_a_method_that_does_not_do_as_agreed_fails_by_name_and_the_others_go_on(sequences, tmp_path, policy, message):
    runs = evaluate(sequences[:1], [policy, "Reader"], tmp_path)
    assert getattr(exploring_policies, policy).name in runs[0].record.failure
    assert message in runs[0].record.failure
    assert "\n" not in runs[0].record.failure
    assert runs[0].record.metrics == failed_metrics(sequences[0].labels)
    assert runs[1].record.metrics["skill"] == 1


@pytest.mark.parametrize(
    "share", [np.array([1001.0, -1000.0]), np.array([np.nan, 1.0]), np.array([2.0, 0.0]), np.array([1.0 + 0j, 0.0])]
)
def test_commands_whose_probabilities_are_none_are_refused(tmp_path, share):
    task = SPLIT.steering
    yaw, pitch = (np.zeros((1, len(degrees)), share.dtype) for degrees in (task.yaw_deg, task.pitch_deg))
    yaw[0, :2], pitch[0, 0] = share, 1.0
    np.savez(tmp_path / COMMANDS, classes=np.zeros((1, 2), np.int64), yaw=yaw, pitch=pitch)
    with pytest.raises(MethodError, match="probabilities that add up to 1"):
        read_classes(tmp_path, task)


def test_a_sequence_without_labels_is_refused_by_name(tmp_path):
    path = write_labelled(tmp_path / "bare.mcap", "bare", None)
    with pytest.raises(LabelError, match=r"bare\.mcap.*steer-mini"):
        labelled_views(path, SPLIT.steering)


def test_labels_and_pictures_that_do_not_belong_together_are_refused(tmp_path):
    table = label_table(6, 3)
    fewer = write_labelled(tmp_path / "fewer.mcap", "fewer", table, pictures=4)
    with pytest.raises(LabelError, match="6 labels, and only 4 images"):
        list(labelled_views(fewer, SPLIT.steering).views())
    shifted = table.assign(stamp_ns=table["stamp_ns"] + 1)
    moved = write_labelled(tmp_path / "moved.mcap", "moved", table)
    labelled = dataclasses.replace(labelled_views(moved, SPLIT.steering), table=shifted)
    with pytest.raises(LabelError, match="expected a label of that stamp"):
        list(labelled.views())
    narrow = write_labelled(tmp_path / "narrow.mcap", "narrow", table.drop(columns="value_6_6"))
    with pytest.raises(LabelError, match="value_6_6"):
        labelled_views(narrow, SPLIT.steering)
    wide = write_labelled(tmp_path / "wide.mcap", "wide", table.assign(value_7_0=0.0))
    with pytest.raises(LabelError, match="7 x 7 commands, got 50"):
        labelled_views(wide, SPLIT.steering)


def test_what_reading_takes_is_not_the_methods():
    now = [0.0]

    class Told(Stopwatch):
        def _now(self):
            return now[0], now[0]

    def views():
        for k in range(3):
            now[0] += 10.0
            yield k

    clock = Told()
    with clock:
        for _ in clock.leave_out(views()):
            now[0] += 1.0
    assert clock.wall_s == pytest.approx(3.0)


@pytest.mark.slow
def test_all_pictures_together_are_only_scored_of_methods_that_failed_nowhere(sequences, tmp_path):
    runs = evaluate(sequences, ["Reader", "Broken"], tmp_path)
    wholes = whole_of(runs)
    assert list(wholes) == ["reader"]
    assert wholes["reader"].score.metrics["pictures"] == 16


def test_policies_are_compared_on_the_same_reefs_and_have_a_place(tmp_path, monkeypatch):
    split = made_split(tuple(f"r{k}" for k in range(7)))
    reefs = [sequence.name for sequence in split.sequence]
    plan = plan_rollouts(split, explore=made_explore)
    runs = run_rollouts(plan, reefs, [POLICIES + ":Reader", *REFERENCES], tmp_path)
    found = places(runs)
    assert set(found) == {"reader", "lawnmower"}
    assert found["lawnmower"].value == pytest.approx(0.5)
    assert found["reader"].value == pytest.approx(0.0)
    assert found["lawnmower"].interval.low == pytest.approx(0.5)
    assert len(places_table(found).rows) == 2
    lines = {texts[0]: texts for texts in policies_table(runs).texts if texts[1].startswith("Oysters")}
    assert len(lines) == 6
    assert lines["expert \N{MINUS SIGN} random"][2:] == ("+130.0", "+130.0 to +130.0", "7 / 0 / 0", "better")
    assert lines["expert \N{MINUS SIGN} lawnmower"][2] == "+65.0"
    near = Comparison(7, 0.06, Interval(0.003, 0.1), 6, 0, 1, "better")
    monkeypatch.setattr(exploring, "compare", lambda *_: near)
    assert policies_table(runs).texts[0][3] == "+0.003 to +0.100"
    assert places([run for run in runs if run.record.method != "random"]) == {}


def test_the_bow_is_drawn_where_the_camera_would_see_it(tmp_path):
    """A camera that looks along the bow, and a level vehicle: by hand."""
    labelled = labelled_views(write_labelled(tmp_path / "one.mcap", "one", label_table(1)), SPLIT.steering)
    view = next(labelled.views())
    along = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    camera = dataclasses.replace(labelled.sequence.cameras["cam_front"], T_base_cam=along)
    labelled.sequence.cameras["cam_front"] = camera
    level = dataclasses.replace(view, state=dataclasses.replace(view.state, pitch=0.0))
    ends, bow = bow_pixels(labelled, level)
    f, (cx, cy) = 19.0, (15.5, 11.5)
    assert bow == pytest.approx([cx, cy])
    assert ends[3, 3] == pytest.approx([cx, cy])
    assert ends[0, 3] == pytest.approx([cx - f * np.tan(np.radians(30)), cy])  # 30 degrees to the left
    assert ends[3, 6] == pytest.approx([cx, cy + f * np.tan(np.radians(24))])  # 24 degrees down
    steep = dataclasses.replace(view, state=dataclasses.replace(view.state, pitch=np.radians(24)))
    ends, _ = bow_pixels(labelled, steep)
    assert ends[3, 6] == pytest.approx([cx, cy + f * np.tan(np.radians(6))])  # the vehicle's limit is 30 degrees
    assert ends[3, 2] == pytest.approx([cx, cy - f * np.tan(np.radians(8))])


@pytest.mark.slow
def test_samples_are_even_over_sequences_and_time(sequences, tmp_path):
    runs = evaluate(sequences, ["Reader", "Broken"], tmp_path)
    samples = samples_of(sequences, runs, 5)
    assert [sample.name for sample in samples] == ["one"] * 3 + ["two"] * 2
    assert [sample.view.time_s for sample in samples[:3]] == [4, 8, 12]
    for sample in samples:
        assert sample.commanded == {"reader": sample.expert}
        assert sample.action_values[sample.expert] == sample.action_values.max()
