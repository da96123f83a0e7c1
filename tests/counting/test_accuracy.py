"""How far a method counts off, from results of the same method, and from the card of the weights that are here."""

from __future__ import annotations

import msgspec
import pytest

from oysterbench.core.errors import ResultError
from oysterbench.counting.accuracy import figures_of_counts, read_accuracy
from oysterbench.results.records import ResultRecord, write_results
from tests.helpers.weights_made import FIGURE, card_of, write_weights


def record(method="m", truth=20.0, estimate=23.0, **further):
    metrics = {"count_truth": truth, "count_estimate": estimate}
    values = {"track": "detection", "split": "", "sequence": "mine", **further}
    return ResultRecord(method=method, metrics=metrics, **values)


def test_counts_of_all_sequences_are_added_up(tmp_path):
    write_results(
        tmp_path / "results.json", [record(), record(sequence="more", truth=80, estimate=62), record("other")]
    )
    found = read_accuracy(tmp_path, "m")
    assert (found.labelled, found.counted, found.where) == (100, 85, "mine, more")
    assert found.percent == pytest.approx(-15)
    assert read_accuracy(tmp_path / "results.json", "m") == found
    write_results(tmp_path / "results.json", [record(settings={"threshold": 0.25})])
    assert (found.threshold, read_accuracy(tmp_path, "m").threshold) == (None, 0.25)


def test_several_runs_on_a_sequence_label_no_more_oysters(tmp_path):
    several = [record(estimate=23 + k, run=k) for k in range(3)] + [record(sequence="more", truth=80, estimate=61)]
    write_results(tmp_path / "results.json", several)
    found = read_accuracy(tmp_path, "m")
    assert (found.labelled, found.counted) == (100, 85)


def test_results_with_other_weights_are_told_apart(tmp_path):
    write_results(tmp_path / "results.json", [record(method_settings={"weights": {"net": "aa"}})])
    assert read_accuracy(tmp_path, "m", {"net": "bb"}).other_weights
    assert not read_accuracy(tmp_path, "m", {"net": "aa"}).other_weights


@pytest.mark.parametrize(
    ("further", "tells"),
    [
        ({}, True),
        ({"split": "seg-val"}, False),
        ({"truth": 0.0}, False),
        ({"method_settings": {"weights": {"n": "b"}}}, False),
    ],
)
def test_results_on_rendered_reefs_of_other_weights_or_without_oysters_tell_nothing_of_counts(tmp_path, further, tells):
    write_results(tmp_path / "results.json", [record(**further)])
    assert read_accuracy(tmp_path, "m", {"n": "a"}).tells is tells


def test_results_of_other_methods_or_tracks_are_refused(tmp_path):
    write_results(tmp_path / "results.json", [record("other"), record(track="segmentation")])
    with pytest.raises(
        ResultError, match=r"expected results of m on the track detection, got other; `oysterbench run m"
    ):
        read_accuracy(tmp_path, "m")


def test_where_nothing_is_labelled_there_is_no_share(tmp_path):
    write_results(tmp_path / "results.json", [record(truth=0.0)])
    assert str(read_accuracy(tmp_path, "m").percent) == "nan"


def test_the_card_of_the_weights_says_how_far_counts_are_off(tmp_path):
    path = write_weights(tmp_path / "unet.pt")
    assert figures_of_counts({"unet": path}, "unet") == []
    bias = msgspec.structs.replace(FIGURE, track="detection", metric="count_bias")
    model = msgspec.structs.replace(card_of(path), figures=(FIGURE, bias))
    path.with_suffix(".json").write_bytes(model.data)
    assert figures_of_counts({"unet": path}, "unet") == [bias]
    assert figures_of_counts({"unet": path}, "another") == []
    write_weights(path, seed=1)
    assert figures_of_counts({"unet": path}, "unet") == [], "weights of one's own have no card"
