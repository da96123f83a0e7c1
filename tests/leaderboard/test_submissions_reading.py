"""What may be sent, read as the limited process reads it; and scored, against the same numbers by another way."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import get_args

import cv2
import numpy as np
import pytest

from oysterbench.annotations import labelled_sequence
from oysterbench.evaluate.segmentation import ClipScorer, EstimateImage, SegmentationSettings
from oysterbench.evaluate.slam.diagnose import Cause
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from oysterbench.results.plausible import BOUNDING
from oysterbench.results.records import ResultRecord, document, read_results, write_results
from oysterbench_leaderboard.submissions.catalogue import SCORED, Catalogue
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.scoring import CAUSES, MISSING, evaluator, score_predictions
from oysterbench_leaderboard.submissions.sending.package import wanted_of as wanted_by_client
from tests.helpers.pool import IMAGES, NAMES, answers, estimate, image_names, path, tum, zipped
from tests.helpers.submissions_read import LIMITS, as_coco, as_png, masks, npz, opened, wanted_of

# Paths:


def test_paths_are_read_in_every_format_and_score_the_same(served, tmp_path):
    wanted = wanted_of(served, "pool-test")
    one, two = estimate(0), estimate(1)
    columns = "#timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z\n"
    rows = [
        ",".join([str(t), *(repr(float(v)) for v in (*p, q[3], *q[:3]))])
        for t, p, q in zip(two.stamps_ns, two.positions, two.quaternions, strict=True)
    ]
    arrays = npz(stamps_ns=one.stamps_ns, positions=one.positions, quaternions=one.quaternions)
    files = {"pool-01.npz": arrays, "pool-02.csv": (columns + "\n".join(rows)).encode()}
    predictions, facts = opened(tmp_path, zipped(files), wanted)
    assert facts == {"kind": "poses", "sequences": list(NAMES), "poses": 400, "images": 0, "notes": []}
    text, _ = opened(tmp_path, zipped({"pool-01.txt": tum(one, tmp_path), "pool-02.tum": tum(two, tmp_path)}), wanted)
    for name, trajectory in zip(NAMES, (one, two), strict=True):
        assert np.allclose(predictions.readers[name]().positions, trajectory.positions, atol=1e-8)
        assert np.allclose(text.readers[name]().positions, trajectory.positions, atol=1e-6)


def test_a_score_is_the_evaluators(served, tmp_path):
    wanted = wanted_of(served, "pool-val")
    predictions, _ = opened(tmp_path, answers(tmp_path), wanted)
    scored = score_predictions(predictions, wanted, served["pool-val"].truth, "carp", "2026-11-01T00:00:00Z")
    for k, record in enumerate(scored.results):
        (tmp_path / "y.tum").write_bytes(tum(estimate(k), tmp_path))
        from oysterbench.core.trajectory import read_trajectory

        expected = score(path(k), read_trajectory(tmp_path / "y.tum"), SlamSettings())
        assert record.metrics["ate_rmse_m"] == pytest.approx(expected.metrics["ate_rmse_m"], rel=1e-9)
        assert record.metrics["score"] == pytest.approx(expected.metrics["score"], rel=1e-9)
        assert (record.evaluator_version, dict(record.settings)) == evaluator("slam")
        assert record.split_digest == wanted.split_digest
    hidden = wanted_of(served, "pool-test")
    again = score_predictions(predictions, hidden, served["pool-test"].truth, "carp", "2026-11-01T00:00:00Z")
    for open_, kept in zip(scored.results, again.results, strict=True):
        assert kept.metrics["score"] == pytest.approx(open_.metrics["score"], abs=0.005)
        assert kept.notes == ()
    assert again.curves is None
    assert set(scored.curves["sequences"]) == set(NAMES)


def test_a_sequence_without_a_file_counts_as_failed(served, tmp_path):
    wanted = wanted_of(served, "pool-test")
    predictions, facts = opened(tmp_path, zipped({"pool-02.tum": tum(estimate(1), tmp_path)}), wanted)
    assert facts["sequences"] == ["pool-02"]
    first, second = score_predictions(predictions, wanted, served["pool-test"].truth, "carp", "x").results
    assert (first.failure, first.metrics["score"], first.metrics["coverage"]) == (MISSING, 0.0, 0.0)
    assert second.failure is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"1 2 3 4 0 0 0 1\n2 2 3 4 0 0 0\n", r"pool-01\.tum:2: expected 8 numbers"),
        (b"1 2 3 4 0 0 0 1\n\n# x\n2 2 3 inf 0 0 0 1\n", r"pool-01\.tum:4: expected finite numbers, got z = inf"),
        (b"1 2 3 4 0 0 0 1\n1 2 3 5 0 0 0 1\n", r"pool-01\.tum:2: expected one pose for each timestamp"),
        (b"1 2 3 4 0 0 0 9\n", r"pool-01\.tum:1: expected a unit quaternion"),
        (b"\xff\xfe\x00", r"pool-01\.tum is not text"),
        (b"", r"pool-01\.tum holds no pose"),
        (b"1 0 0 0 0 1 0 0 0 0 1 0\n", r"pool-01\.tum: KITTI poses have no timestamps"),
    ],
)
def test_what_is_wrong_with_a_path_is_said_by_line(served, tmp_path, text, message):
    with pytest.raises(Refusal, match=message):
        opened(tmp_path, zipped({"pool-01.tum": text}), wanted_of(served, "pool-test"))


# Images:


def test_masks_arrays_and_annotations_score_the_same(served, tmp_path):
    both = {**masks(0), **masks(1)}
    forms = {
        "png": zipped({f"{name}.png": as_png(mask) for name, mask in both.items()}),
        "npz": npz(**both),
        "npz of each": zipped({f"{name}.npz": npz(**masks(k)) for k, name in enumerate(NAMES)}),
        "coco": as_coco(both),
        "coco of each": zipped({f"{name}.json": as_coco(masks(k)) for k, name in enumerate(NAMES)}),
    }
    truth = served["pool-masks"].truth
    for track, key in (("segmentation", "iou"), ("detection", "ap_mask")):
        wanted = wanted_of(served, "pool-masks", track)
        found = {}
        for form, data in forms.items():
            predictions, facts = opened(tmp_path, data, wanted)
            assert facts == {
                "kind": "predictions",
                "sequences": list(NAMES),
                "poses": 0,
                "images": 2 * IMAGES,
                "notes": [],
            }
            scored = score_predictions(predictions, wanted, truth, "net", "2026-11-01T00:00:00Z")
            found[form] = [record.metrics[key] for record in scored.results]
            assert scored.data_set["metrics"][key] > 0
        assert len({tuple(values) for values in found.values()}) == 1, found
        assert all(0.3 < value <= 1 for value in found["png"])


def test_a_client_without_the_images_compares_their_number_with_what_the_server_tells(served, tmp_path):
    here = wanted_of(served, "pool-masks", "segmentation")
    (known,) = Catalogue([served["pool-masks"]]).public()
    wanted = replace(wanted_by_client("pool-masks", "segmentation", known), split_digest=here.split_digest)
    assert not wanted.images
    found = {f"{name}.png": as_png(mask) for name, mask in masks(0).items()}
    assert opened(tmp_path, zipped(found), wanted)[1]["images"] == IMAGES
    first, *others = found
    lacking = {name: found[name] for name in others}
    one_more = found | {f"{first[: -len('.png')]}0.png": found[first]}
    for data, count in ((lacking, IMAGES - 1), (one_more, IMAGES + 1)):
        with pytest.raises(Refusal, match=f"^{NAMES[0]}: expected predictions for {IMAGES} images, got {count}$"):
            opened(tmp_path, zipped(data), wanted)


def test_what_the_values_of_masks_mean_is_judged_by_all_of_them_together(served, tmp_path):
    """As `oysterbench eval` judges: a picture of two probabilities is no mask, and oysters that touch are two."""
    wanted = wanted_of(served, "pool-masks", "segmentation")
    likely = {name: np.where(mask, 250, 3).astype(np.uint8) for name, mask in masks(0).items()}
    last = list(likely)[-1]
    faint = likely | {last: np.ones_like(likely[last])}
    sent = {
        "png": zipped({f"{name}.png": cv2.imencode(".png", values)[1].tobytes() for name, values in faint.items()}),
        "npz": npz(**faint),
    }
    for data in sent.values():
        with pytest.raises(Refusal, match=r"has only 0 and 1, like a mask, .* or send them as floating-point numbers"):
            opened(tmp_path, data, wanted)

    numbers = np.zeros((48, 64), np.uint16)
    numbers[5:20, 5:20], numbers[5:20, 20:35], numbers[30:40, 5:20] = 1, 2, 3
    wanted = wanted_of(served, "pool-masks", "detection")
    predictions, _ = opened(tmp_path, npz(**dict.fromkeys(masks(0), numbers)), wanted)
    assert [len(predictions.readers[name]().instances) for name in masks(0)] == [3] * IMAGES


def test_an_iou_is_the_evaluators(served, tmp_path):
    wanted = wanted_of(served, "pool-masks", "segmentation")
    predictions, _ = opened(tmp_path, npz(**masks(0, 2)), wanted)
    first, second = score_predictions(predictions, wanted, served["pool-masks"].truth, "net", "x").results
    scorer = ClipScorer(SegmentationSettings())
    for truth, _ in labelled_sequence(served["pool-masks"].truth["pool-01"]).images():
        scorer.add(truth, EstimateImage(truth.name, oyster=masks(0, 2)[truth.name]))
    assert first.metrics["iou"] == pytest.approx(scorer.result().metrics["iou"], abs=0.005)
    assert second.failure == MISSING
    assert second.metrics["union_px"] > 0, "it counts by the pixels that it missed"


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: npz(**dict(list(masks(0).items())[:2])), "pool-01: 1 of 3 images have no prediction"),
        (lambda: npz(**{"pool-01/cam/7": np.ones((48, 64), bool)}), "names no image of pool-masks"),
        (lambda: npz(**{name: mask[:, :60] for name, mask in masks(0).items()}), "expected 64 x 48 pixels"),
        (lambda: npz(**{name: mask * 2.0 for name, mask in masks(0).items()}), "expected probabilities from 0 to 1"),
        (lambda: npz(**{name: np.where(mask, np.nan, 0) for name, mask in masks(0).items()}), "from 0 to 1, got nan"),
        (lambda: zipped({f"{name}.png": as_png(mask)[:-9] for name, mask in masks(0).items()}), "incomplete PNG"),
        (lambda: zipped({f"{name}.png": b"<svg/>" for name in image_names(0)}), "not a PNG file"),
        (lambda: as_coco(masks(0)).replace(b'"counts": [', b'"counts": [9, '), "add up to 3072 pixels, got 3081"),
        (lambda: as_coco(masks(0)).replace(b'"width": 64', b'"width": 6400'), "expected 64 x 48 pixels"),
        (lambda: as_coco(masks(0)).replace(b'"image_id": 0', b'"image_id": 99'), r"annotations\[0\]: image_id 99"),
        (lambda: b"[" * 100_000, "not valid JSON"),
        (lambda: b"1 2 3 4 0 0 0 1\n", "expected COCO annotations"),
    ],
)
def test_what_is_wrong_with_masks_is_said_by_name(served, tmp_path, made, message):
    with pytest.raises(Refusal, match=message) as refused:
        opened(tmp_path, made(), wanted_of(served, "pool-masks", "segmentation"))
    assert "/proc/" not in refused.value.reason
    assert str(tmp_path) not in refused.value.reason


@pytest.mark.parametrize(
    ("line_end", "message"),
    [
        ("\n", "expected at most 120000 lines, got 125000"),
        ("\r", "expected at most 120000 lines, got 125000"),
        (" ", "expected lines of at most 4000 bytes, got 1124999"),
    ],
)
def test_text_that_would_take_long_is_refused_unread(served, tmp_path, monkeypatch, line_end, message):
    monkeypatch.setattr("oysterbench.core.trajectory.text.read_text", None)
    digits = np.random.default_rng(1).bytes(500_000).hex()  # which no archive makes much smaller
    text = line_end.join(digits[k : k + 8] for k in range(0, len(digits), 8))
    with pytest.raises(Refusal, match=message):
        opened(tmp_path, zipped({"pool-01.tum": text.encode()}), wanted_of(served, "pool-test"))


def test_more_annotations_than_an_image_may_have_are_refused_unread(served, tmp_path, monkeypatch):
    found = json.loads(as_coco(masks(0)))
    first, *_ = found["annotations"]
    found["annotations"] = [{**first, "id": k} for k in range(LIMITS.annotations + 1)]
    monkeypatch.setattr("oysterbench_leaderboard.submissions.reading.predictions.image_track", lambda name: None)
    for track in ("segmentation", "detection"):
        with pytest.raises(Refusal, match=r"^upload\.json: pool-01/\S+: expected at most 5000 annotations of an image"):
            opened(tmp_path, json.dumps(found).encode(), wanted_of(served, "pool-masks", track))


def test_a_number_of_too_many_digits_is_called_so(served, tmp_path):
    data = b'{"results": [' + b"9" * 5000 + b"]}"
    with pytest.raises(Refusal, match=r"^upload\.json: not valid JSON: it has a number of too many digits$"):
        opened(tmp_path, data, wanted_of(served, "pool-val"))


# Results:


def reported(served, tmp_path, **changes) -> bytes:
    """A results.json of the public split."""
    wanted = wanted_of(served, "pool-val")
    predictions, _ = opened(tmp_path, answers(tmp_path), wanted)
    scored = score_predictions(predictions, wanted, served["pool-val"].truth, "mine", "2025-01-01T00:00:00Z")
    write_results(tmp_path / "results.json", [replace(record, **changes) for record in scored.results])
    return (tmp_path / "results.json").read_bytes()


def test_results_of_a_public_split_are_taken_as_their_authors_computed_them(served, tmp_path):
    wanted = wanted_of(served, "pool-val")
    data = reported(served, tmp_path, conditions={"water": "clear"}, seed=3)
    predictions, facts = opened(tmp_path, data, wanted)
    assert facts["kind"] == "results"
    scored = score_predictions(predictions, wanted, {}, "carp", "x")
    before = read_results(tmp_path / "results.json")
    assert [dict(record.metrics) for record in scored.results] == [dict(record.metrics) for record in before]
    assert {record.method for record in scored.results} == {"carp"}
    assert scored.results[0].conditions == wanted.conditions["pool-01"], "what it was like says the server"
    assert scored.results[0].seed == 3


def test_whether_the_split_of_reported_results_is_hidden_says_the_server(served, tmp_path):
    wanted = wanted_of(served, "pool-val")
    predictions, _ = opened(tmp_path, reported(served, tmp_path, hidden=True), wanted)
    assert {one.hidden for one in score_predictions(predictions, wanted, {}, "carp", "x").results} == {False}


def test_results_that_are_reported_lose_the_folders_of_the_machine_they_come_from(served, tmp_path):
    wanted = wanted_of(served, "pool-val")
    run = {"command": ["/opt/mine.sh"], "versions": {"sha256 of /opt/mine.sh": "ab"}}
    data = reported(served, tmp_path, info={"run": run}, notes=("its log is /home/me/runs/x.log",))
    predictions, _ = opened(tmp_path, data, wanted)
    one = score_predictions(predictions, wanted, {}, "carp", "x").results[0]
    assert one.info["run"] == {"command": ["mine.sh"], "versions": {"sha256 of mine.sh": "ab"}}
    assert one.notes == ("its log is x.log",)


USUAL = SlamSettings().as_dict()
WHOLE = dict.fromkeys(BOUNDING["slam"], 1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"split_digest": "0" * 64}, r"results\[0\]: key 'split_digest': expected"),
        ({"split": "slam-val"}, r"results\[0\]: key 'split': expected pool-val"),
        ({"sequence": "pool-99"}, "'pool-99' is no sequence of pool-val"),
        ({"evaluator_version": "slam 99"}, "expected the evaluator 'slam 3'"),
        ({"settings": {"align": "sim3"}}, "with its usual settings"),
        ({"settings": USUAL | {"align": "sim3"}}, r"key 'settings.align': expected 'posyaw', got 'sim3'; evaluate"),
        ({"settings": USUAL | {"mine": 1}}, r"key 'settings.mine': expected nothing, got 1"),
        ({"settings": {"align": "posyaw"}}, r"key 'settings.align_first': expected None, got nothing"),
        ({"metrics": {"<script>": 1.0}}, "'<script>' is no metric"),
        ({"info": {"x": "a\u202eb"}}, "plain text in one line"),
        ({"info": {"x": "y" * 3000}}, "at most 2000 characters"),
        (
            {"info": {"method": {"code": "http://[x"}}},
            r"key 'info.method.code': expected a web address, .*'http://\[x'",
        ),
        ({"run": 1, "sequence": "pool-01"}, "each run of a sequence once"),
        ({"hardware": {"cpu": "x" * 300}}, r"results\[0\]: key 'hardware': expected at most 200 characters"),
        (
            {"created": "2099-01-01T00:00:00Z"},
            r"results\[0\]: key 'created': expected a time from 2020 to now, .*'2099-",
        ),
        ({"created": "0000-99-99"}, "key 'created': expected a time from 2020 to now"),
        ({"created": "<b>not a date"}, "key 'created': expected a time from 2020 to now"),
        ({"created": "2019-12-31T23:59:59Z"}, "key 'created': expected a time from 2020 to now"),
        ({"created": "2025-01-01T00:00:00"}, "key 'created': expected a time from 2020 to now"),
        ({"metrics": WHOLE | {"realtime_factor": 1e12}}, "metric 'realtime_factor': expected 0 to 100000"),
        ({"metrics": {"score": 5.0, "coverage": 1.0}}, "expected the metrics recall_0.5percent"),
        ({"metrics": WHOLE | {"score": 1e300}}, r"results\[0\]: metric 'score': expected 0 to 1, got 1e\+300"),
        ({"metrics": WHOLE | {"recall_0.5percent": 0.1}}, "the score does not belong to the recalls"),
    ],
)
def test_results_that_would_not_stand_on_the_board_are_refused(served, tmp_path, changes, message):
    data = reported(served, tmp_path, **changes)
    with pytest.raises(Refusal, match=message):
        opened(tmp_path, data, wanted_of(served, "pool-val"))


def test_what_was_computed_by_a_clock_that_is_hours_ahead_is_taken(served, tmp_path):
    for ahead in (timedelta(hours=20), timedelta(hours=-20)):
        created = (datetime.now(UTC) + ahead).strftime("%Y-%m-%dT%H:%M:%SZ")
        opened(tmp_path, reported(served, tmp_path, created=created), wanted_of(served, "pool-val"))


def test_results_against_another_truth_are_refused(served, tmp_path):
    wanted, truth = wanted_of(served, "pool-val"), served["pool-val"].truth
    made_up, _ = opened(tmp_path, reported(served, tmp_path, truth_digest="0" * 64), wanted)
    with pytest.raises(
        Refusal, match="pool-01: the results were computed against a ground truth other than the split's"
    ):
        score_predictions(made_up, wanted, truth, "carp", "x")
    honest, _ = opened(tmp_path, reported(served, tmp_path), wanted)
    assert len(score_predictions(honest, wanted, truth, "carp", "x").results) == len(wanted.sequences)


def test_results_of_a_hidden_split_are_refused(served, tmp_path):
    with pytest.raises(Refusal, match="pool-test is hidden: results are computed here"):
        opened(tmp_path, reported(served, tmp_path), wanted_of(served, "pool-test"))


def test_results_with_half_a_character_are_refused(served, tmp_path):
    row = ResultRecord.from_dict(json.loads(reported(served, tmp_path))["results"][0])
    text = json.dumps(document([replace(row, info={"x": "MARK"})])).replace("MARK", "\\ud800")
    with pytest.raises(Refusal):
        opened(tmp_path, text.encode(), wanted_of(served, "pool-val"))


def test_tracks_that_cannot_be_submitted_are_refused_with_those_that_can(served, tmp_path):
    catalogue = Catalogue(served.values())
    for split, track in (("pool-val", "density"), ("pool-dive", "exploration")):
        with pytest.raises(Refusal, match=f"{served[split].any.track}, got '{track}': .* are scored locally"):
            catalogue.find(split, track)
        with pytest.raises(Refusal, match=f"'{track}' cannot be submitted.*are {', '.join(SCORED)}$"):
            evaluator(track)
    with pytest.raises(Refusal, match="key 'track': expected slam, got 'density': maps are scored locally"):
        opened(tmp_path, reported(served, tmp_path, track="density"), wanted_of(served, "pool-val"))


def test_every_track_that_can_be_submitted_has_an_evaluator_and_a_line_on_the_page():
    from oysterbench.results.standings import PRIMARY
    from oysterbench_leaderboard.site.pages.prose import FORMS
    from oysterbench_leaderboard.submissions.catalogue import ELSEWHERE, KIND_OF

    assert set(SCORED) == set(FORMS) == set(KIND_OF)
    assert set(SCORED) | set(ELSEWHERE) == set(PRIMARY)
    assert [evaluator(track)[0].split()[0] for track in SCORED] == ["slam", "segmentation", "detection", "navigation"]


# Splits:


def test_a_catalogue_says_what_there_is(served):
    catalogue = Catalogue(served.values())
    with pytest.raises(Refusal, match="the splits are pool-test, pool-val, pool-masks, pool-steer"):
        catalogue.find("slam-test", "")
    with pytest.raises(Refusal, match="pool-masks has the tracks segmentation, detection, got 'slam'"):
        catalogue.find("pool-masks", "slam")
    assert catalogue.find("pool-masks", "")[1].track == "segmentation"
    told = json.dumps(catalogue.public())
    assert "mcap" not in told
    assert "truth" not in told


def test_every_finding_that_refuses_a_path_has_a_sentence_of_its_own():
    notes_alone = {"swapped", "truth-length-unit"}
    assert set(CAUSES) == set(get_args(Cause)) - notes_alone
