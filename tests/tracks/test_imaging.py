"""Methods of images are given pictures and no truth, and every way to score ends in records, tables and a report."""

from __future__ import annotations

import json
import shutil
import sys

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from oysterbench.annotations import LabelledSequence, open_predictions
from oysterbench.cli.main import main
from oysterbench.core.errors import LabelError, MethodError, MissingExtraError
from oysterbench.core.streams import stream
from oysterbench.evaluate.segmentation import TruthImage
from oysterbench.methods.exports import key_of
from oysterbench.methods.images import Detections, Segmentation
from oysterbench.recipe import OYSTER
from oysterbench.report import dataset_tables, html_report, images_csv
from oysterbench.results.records import ResultRecord
from oysterbench.tracks import TRACKS, Request
from oysterbench.tracks.images import PictureSequence, instances_of
from tests.helpers.labelled_folders import write_png
from tests.helpers.track_runs import runs_of


def make_clip(name, images=3):
    """Light squares on dark ground, which are oysters; the last picture has none."""
    rng = stream(2, b"", "imaging", name)
    made = []
    for k in range(images):
        classes = np.zeros((48, 64), np.uint8)
        if k < images - 1:
            classes[10:22, 8:20] = classes[30:40, 40:54] = OYSTER
        instances = cv2.connectedComponents((classes == OYSTER).astype(np.uint8))[1].astype(np.uint16)
        grey = np.where(classes == OYSTER, 180, 60) + rng.integers(0, 20, classes.shape)
        pixels = np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)
        made.append((TruthImage(f"{name}/{k}", classes, False, instances=instances, footprint_m2=2.0), pixels))
    return LabelledSequence(
        name, tuple(truth.name for truth, _ in made), lambda: iter(made), "0" * 64, {"water": name[-1]}
    )


@pytest.fixture
def clips():
    return [make_clip("clip-a"), make_clip("clip-b", 2)]


METHODS = "tests.helpers.image_methods"


def evaluate(track, clips, methods, out):
    """Runs and rows of the data set; methods: names, or classes of METHODS."""
    track = TRACKS[track]
    references = [f"{METHODS}:{name}" if name[0].isupper() else name for name in methods]
    sequences = [PictureSequence(clip) for clip in clips]
    found = track.show(runs_of(track, sequences, references, track.settings({}), out), sequences, None)
    return found.runs, found.data_set


@pytest.mark.slow
def test_trivial_rows_are_worth_what_the_cover_says(clips, tmp_path):
    runs, rows = evaluate("segmentation", clips, ["all", "none", "Light"], tmp_path)
    by_name = {row.method: row.metrics for row in rows}
    cover = by_name["all"]["cover"]
    assert by_name["all"]["iou"] == pytest.approx(cover)
    assert by_name["none"]["iou"] == 0.0
    assert by_name["none"]["image_iou"] == pytest.approx(2 / 5)  # two of five pictures have no oyster
    assert by_name["light"]["iou"] == 1.0
    assert by_name["all"]["empty_false_positive_rate"] == 1.0
    assert by_name["light"]["empty_false_positive_rate"] == 0.0
    for run in runs:
        assert ResultRecord.from_dict(json.loads(run.record.to_json())).to_json() == run.record.to_json()
        assert run.record.metrics["images_per_s"] > 0


def test_a_colour_that_differs_from_its_surroundings_is_found(clips, tmp_path):
    _, rows = evaluate("segmentation", clips, ["colour"], tmp_path)
    assert rows[0].metrics["iou"] > 2 * rows[0].metrics["cover"]
    assert rows[0].whole.curve is not None


def test_methods_that_fail_have_a_record_that_finds_nothing_and_the_others_go_on(clips, tmp_path):
    methods = ["Raises", "Another", "Small", "Thing", "Light"]
    runs, rows = evaluate("segmentation", clips[:1], methods, tmp_path)
    failures = {run.record.method: run.record.failure for run in runs}
    assert failures["raises"] == "method 'raises' failed on clip-a: ValueError: no idea"
    assert "expected a prediction for clip-a/0, got one for 'x'" in failures["another"]
    assert "expected an estimate of the truth's size, 64 x 48, got 2 x 2" in failures["small"]
    assert "expected a Segmentation or Detections, got Picture" in failures["thing"]
    assert failures["light"] is None
    assert [row.method for row in rows] == ["light"]
    record = runs[0].record
    assert record.metrics["iou"] == 0.0
    assert record.metrics["union_px"] == record.metrics["truth_px"] == 2 * (144 + 140)


def test_an_answer_too_few_is_a_failure(clips, tmp_path):
    runs, _ = evaluate("segmentation", clips[:1], ["Lazy"], tmp_path)
    assert "expected 3 predictions, one for each image, got 1" in runs[0].record.failure


def test_what_hangs_together_is_one_oyster_and_detections_are_taken_as_they_are(clips, tmp_path):
    methods = ["Light", "Numbered", "Boxed", "none"]
    runs, rows = evaluate("detection", clips, methods, tmp_path)
    assert all(run.record.failure is None for run in runs)
    by_name = {row.method: row.metrics for row in rows}
    for name in ("light", "numbered"):
        assert by_name[name]["ap_mask"] == pytest.approx(1.0)
        assert by_name[name]["pq"] == pytest.approx(1.0)
    assert by_name["boxed"]["ap_box"] == pytest.approx(1.0)
    assert by_name["boxed"]["ap_mask"] == 0.0
    assert by_name["none"]["density_error_per_m2"] == pytest.approx(-6 / 10)


def test_what_the_machine_lacks_for_matching_oysters_is_no_failure_of_a_method(clips, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pycocotools", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'oysterbench\[score\]'"):
        evaluate("detection", clips[:1], ["none"], tmp_path)
    request = Request(tmp_path / "map", places=[tmp_path / "no.mcap"], methods=[f"{METHODS}:Numbered"])
    with pytest.raises(MissingExtraError, match=r"pip install 'oysterbench\[score\]'"):
        TRACKS["density"].evaluate(request)


ONE = np.zeros((48, 64), np.uint8)
ONE[10:22, 8:20] = 1


@pytest.mark.parametrize(
    ("scores", "given", "message"),
    [
        ([0.9], {"numbers": ONE[:2, :2]}, "expected a prediction of the image's size, 64 x 48, got 2 x 2"),
        ([0.9], {"numbers": np.dstack([ONE, ONE])}, r"integers \(H, W\) from 0 .* of shape \(48, 64, 2\)"),
        ([0.9], {"numbers": ONE - 2.5}, "integers .* got float64"),
        ([0.9], {"numbers": ONE.astype(np.int64) - (1 << 32)}, "integers .* got int64"),
        ([0.9], {"numbers": ONE * 2}, "expected a score for each of 2 oysters, got 1"),
        ([np.nan], {"numbers": ONE}, "expected scores"),
        (["high"], {"numbers": ONE}, "expected scores"),
        ([0.9], {"masks": ONE}, r"expected a score for each of 48 oysters"),
        ([0.9] * 48, {"masks": ONE}, r"expected masks \(N, H, W\)"),
        ([0.9], {"masks": ONE[None] * 3}, "expected a mask of bool, or of the integers 0 and 1"),
        ([0.9], {"boxes": np.ones((1, 8))}, r"expected boxes \(N, 4\), .* of shape \(1, 8\)"),
        ([0.9], {"boxes": np.array([[1, 2, 1e200, 1e200]])}, "expected a box .* in or near the image of 64 x 48"),
        ([0.9], {"boxes": np.array([[1, 2, np.nan, 1]])}, "expected a box"),
        ([0.9], {"boxes": np.array([[1, 2, -3, 1]])}, "expected a box"),
        ([0.9], {"numbers": ONE, "live": np.array([1.5])}, r"expected live \(1,\), a probability"),
        ([0.9], {"numbers": ONE, "live": np.array([0.5, 0.5])}, r"expected live \(1,\), a probability .* of 2"),
        ([0.9], {"numbers": ONE, "live": np.array(["yes"])}, r"expected live \(1,\), a probability"),
    ],
)
def test_detections_of_other_shapes_types_and_ranges_are_refused_in_a_line(scores, given, message):
    with pytest.raises((MethodError, LabelError), match=message):
        instances_of(Detections("a", np.array(scores), **given), "x", (48, 64), 0.5)


@pytest.mark.parametrize("given", [{"numbers": ONE}, {"masks": ONE[None] == 1}, {"boxes": np.array([[8, 10, 12, 12]])}])
def test_a_detection_may_say_whether_the_oyster_is_alive(given):
    for live in (0.25, np.nan):
        prediction = Detections("a", np.array([0.9]), live=np.array([live]), **given)
        (one,) = instances_of(prediction, "x", (48, 64), 0.5).instances
        assert one.live == pytest.approx(live, nan_ok=True)


def test_bytes_that_no_bool_has_are_taken_for_true_in_masks_of_single_oysters():
    masks = (ONE[None] * np.uint8(7)).view(bool)
    (one,) = instances_of(Detections("a", np.array([0.9]), masks=masks), "x", (48, 64), 0.5).instances
    assert one.area == ONE.sum()
    whole = instances_of(Segmentation("a", oyster=masks[0]), "x", (48, 64), 0.5)
    assert [each.area for each in whole.instances] == [ONE.sum()]


def test_the_report_has_tables_curves_and_pictures(clips, tmp_path):
    runs, rows = evaluate("segmentation", clips, ["all", "colour"], tmp_path)
    page = html_report(runs, "oysterbench eval", data_set=rows)
    for text in ("Over the data set", "IoU over the threshold of probability", "Images", "data:image/jpeg;base64"):
        assert text in page
    assert page.count("<figure>") == 2 * (3 + 2)
    titles = [table.title for table in dataset_tables(rows)]
    assert titles == ["Over the data set", "By class within images"]
    lines = images_csv(runs).splitlines()
    assert len(lines) == 1 + 2 * 5
    assert lines[0].startswith("clip,method,run,image,iou")
    runs, rows = evaluate("detection", clips, ["Light"], tmp_path)
    assert "at an overlap of 0.5" in html_report(runs, "oysterbench eval", data_set=rows)


@pytest.fixture
def folders(tmp_path):
    mask = np.zeros((20, 30), np.uint8)
    mask[5:15, 5:15] = 255
    for clip in ("one", "two"):
        for side, values in (("truth", mask), ("estimate", np.roll(mask, 5, axis=1))):
            (tmp_path / side / clip).mkdir(parents=True)
            assert cv2.imwrite(str(tmp_path / side / clip / "a.png"), values)
    return tmp_path


def command(*arguments):
    return CliRunner().invoke(main, ["eval", *map(str, arguments)])


def test_folders_are_scored_from_the_command_line(folders):
    files = ("--truth", folders / "truth", "--estimate", folders / "estimate")
    done = command("--track", "segmentation", *files, "--json", "--out", folders / "out")
    assert done.exit_code == 0, done.output
    document = json.loads((folders / "out" / "results.json").read_text())
    assert document["data_set"][0]["metrics"]["iou"] == pytest.approx(1 / 3)
    assert [record["sequence"] for record in document["results"]] == ["one", "two"]
    assert {path.name for path in (folders / "out").iterdir()} >= {
        "report.html",
        "results.csv",
        "results.md",
        "images.csv",
    }
    again = command("--track", "segmentation", *files)
    assert "Over the data set" in again.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--align", "se3"], "--align: of the tracks slam and density, not of segmentation"),
        (["--max-detections", "9"], "--max-detections: of the track detection"),
        (["--threshold", "2"], "--threshold: expected"),
        (["--estimate-kind", "classes"], "unknown class 255"),
    ],
)
def test_bad_requests_are_refused_in_one_line(folders, arguments, message):
    done = command(
        "--track", "segmentation", "--truth", folders / "truth", "--estimate", folders / "estimate", *arguments
    )
    assert done.exit_code != 0
    assert message in done.output
    (line,) = [line for line in done.output.splitlines() if message in line]
    assert len(line) < 300


def test_a_missing_pair_is_named(folders):
    (folders / "estimate" / "two" / "a.png").unlink()
    done = command("--track", "segmentation", "--truth", folders / "truth", "--estimate", folders / "estimate")
    assert done.exit_code == 1
    assert "no prediction for two/a" in done.output


def test_a_mask_of_another_size_is_named_by_its_file_and_advised_of_as_a_mask(folders):
    file = folders / "estimate" / "two" / "a.png"
    assert cv2.imwrite(str(file), np.full((10, 15), 255, np.uint8))
    done = command("--track", "segmentation", "--truth", folders / "truth", "--estimate", folders / "estimate")
    assert done.exit_code == 1
    assert f"{file}: expected an estimate of the truth's size, 30 x 20, got 15 x 10; resize masks" in done.output
    assert "bilinear" not in done.output


def test_masks_are_cut_into_the_same_oysters_as_ground_truth_and_as_estimate(tmp_path):
    mask = np.zeros((60, 60), np.uint8)
    mask[10:20, 10:20] = mask[20:30, 20:30] = 255  # two squares that meet at a corner
    for folder in ("truth/images", "truth/masks", "estimate"):
        (tmp_path / folder).mkdir(parents=True)
        assert cv2.imwrite(str(tmp_path / folder / "a.png"), mask)
    (run,) = TRACKS["detection"].score_files(tmp_path / "truth", tmp_path / "estimate", {}).runs
    metrics = run.record.metrics
    values = [metrics[key] for key in ("count_truth", "count_estimate", "ap_mask", "pq")]
    assert values == pytest.approx([1, 1, 1, 1])


def test_images_that_were_renamed_are_given_to_programs_by_their_new_names(tmp_path):
    def key_of_images(*names):
        shutil.rmtree(tmp_path / "mine", ignore_errors=True)
        for k, name in enumerate(names):
            for folder, value in (("images", 10 * k), ("masks", 255)):
                write_png(tmp_path / "mine" / folder / f"{name}.png", np.full((4, 4), value, np.uint8))
        (sequence,) = TRACKS["segmentation"].run_sequences(None, {"mine": tmp_path / "mine"}, {})
        return key_of(sequence, "images")

    before = key_of_images("1", "2")
    assert key_of_images("reef-a", "reef-b") != before
    assert key_of_images("1", "2") == before


def test_files_may_number_oysters_as_panoptic_tools_do(tmp_path):
    np.save(tmp_path / "a.npy", np.where(ONE, np.iinfo(np.int32).max, 0).astype(np.int32))
    track = TRACKS["detection"]
    found = track.of_masks(open_predictions(tmp_path, "instances"), "a", ONE.shape, track.settings({}))
    assert [(one.area, one.score) for one in found.instances] == [(ONE.sum(), 1.0)]
