"""The experiment: what is trained on what, that it goes on where it was stopped, and what its table says."""

from __future__ import annotations

import contextlib
import dataclasses
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from oysterbench.core.errors import LabelError, MethodError, ResultError  # noqa: E402
from oysterbench.evaluate.statistics import resample_counts  # noqa: E402
from oysterbench.results.records import ResultRecord, read_results  # noqa: E402
from oysterbench_baselines.learning.checkpoint import read_checkpoint  # noqa: E402
from oysterbench_baselines.sim2real import data, work  # noqa: E402
from oysterbench_baselines.sim2real.command import command  # noqa: E402
from oysterbench_baselines.sim2real.data import drawn, real_data  # noqa: E402
from oysterbench_baselines.sim2real.experiment import run  # noqa: E402
from oysterbench_baselines.sim2real.plot import curves_of, plot  # noqa: E402
from oysterbench_baselines.sim2real.report import table_of  # noqa: E402
from oysterbench_baselines.sim2real.scoring import (  # noqa: E402
    WHOLE,
    Prediction,
    Truth,
    score,
)
from oysterbench_baselines.sim2real.settings import ALL, SCHEDULES, Cell, ExperimentSettings, Schedule, cells_of  # noqa: E402
from oysterbench_baselines.sim2real.table import variants  # noqa: E402
from oysterbench_baselines.sim2real.trivial import TRIVIAL, predictions  # noqa: E402
from oysterbench_baselines.sim2real.work import Bench  # noqa: E402
from tests.helpers.small_trainings import SMALL, small_set  # noqa: E402

SETTINGS = ExperimentSettings(
    sizes=(2, ALL),
    seeds=1,
    batch=4,
    block=2,
    similarity=0.99,  # these small pictures are all alike
    network=SMALL.network,
    augmentation=SMALL.augmentation,
    fit=dataclasses.replace(SMALL.fit, steps=5),
)
CLIPS = {"a": ("train", 3), "b": ("train", 2), "c": ("test", 4), "d": ("test", 4)}


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("real") / "real", CLIPS)


@pytest.fixture(scope="module")
def synthetic(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("synthetic") / "made", {"s": ("", 4)}, first=50)


def experiment(real, synthetic, out, settings=SETTINGS, echoed=None, **options):
    """Run it; the rows of its table."""
    echoed = [] if echoed is None else echoed
    options = {"hold_out": (), "device": "cpu", "train": True, **options}
    return run(
        real,
        synthetic,
        settings,
        out,
        bar=lambda title, unit: contextlib.nullcontext(lambda done, total: None),
        echo=echoed.append,
        show=echoed.append,
        **options,
    )


# What is trained on what


def test_cells_are_every_variant_at_every_size_and_each_synthetic_set_alone():
    cells = cells_of(("rendered", "cut"), dataclasses.replace(SETTINGS, seeds=3))
    assert len(cells) == len({cell.folder for cell in cells}) == 3 * (2 + 2 * 3)
    assert {cell.variant for cell in cells} == {"rendered only", "cut only", "real", "real + rendered", "real + cut"}
    assert [cell.seed for cell in cells] == sorted(cell.seed for cell in cells)


def test_few_images_are_among_more_and_come_from_all_clips(real):
    train = real.of_split("train")
    for seed in range(5):
        names = [{entry.name for entry in drawn(train, size, seed).entries} for size in (2, 3, 5)]
        assert names[0] < names[1] < names[2]
        assert {entry.clip for entry in drawn(train, 2, seed).entries} == {"a", "b"}
    assert len({tuple(entry.name for entry in drawn(train, 2, seed).entries) for seed in range(20)}) > 1
    assert len(drawn(train, ALL, 0)) == 5
    with pytest.raises(LabelError, match="6 real images are asked for, but there are 5"):
        drawn(train, 6, 0)


def test_clips_held_out_are_tested_on_and_the_test_side_is_not_looked_at(real):
    found = real_data(real, ("a",), 0.99)
    assert (found.train.clips, found.test.clips) == (("b",), ("a",))
    with pytest.raises(LabelError, match="--hold-out c: expected a clip of the training side: a, b"):
        real_data(real, ("c",), 0.99)


def test_a_training_image_that_is_a_test_image_under_another_name_is_left_out_and_named(tmp_path):
    twice = small_set(tmp_path / "twice", CLIPS)
    copy = (tmp_path / "twice" / "images" / "a-1.png").read_bytes()
    (tmp_path / "twice" / "images" / "c-6.png").write_bytes(copy)
    found = real_data(twice, (), 0.99)
    assert ("a-1", "c-6") in {(leak.one, leak.other) for leak in found.leaks}
    assert "a-1" not in {entry.name for entry in found.train.entries}
    assert "a-0" in {entry.name for entry in found.train.entries}


def test_real_and_synthetic_begin_with_the_weights_of_synthetic_alone_and_all_have_as_many_steps(
    real, synthetic, tmp_path
):
    settings = dataclasses.replace(SETTINGS, schedule=Schedule(share=0.4, rate=2e-3, kept=0))
    bench = Bench(real_data(real, (), 0.99), {"made": synthetic}, settings, "cpu")
    alone, both, only = Cell("made", None, 0), Cell("made", 2, 0), Cell("", 2, 0)
    assert both.begun == alone
    assert only.begun is None is alone.begun
    steps = {cell: settings.fit_of(cell).steps for cell in (alone, both, only)}
    assert steps[alone] + steps[both] == steps[only] == 5
    assert settings.fit_of(both).learning_rate == 2e-3 < settings.fit_of(only).learning_rate
    still = dataclasses.replace(settings, schedule=Schedule(0.4, 0.0, 0))  # learning nothing shows where it began
    bench = Bench(bench.real, bench.synthetic, still, "cpu")
    bench.train(both, tmp_path / both.folder, lambda done, total: None)
    first, last = (read_checkpoint(tmp_path / cell.folder / "checkpoint.pt") for cell in (alone, both))
    assert (first.step, last.step) == (3, 2)
    assert all(torch.equal(first.weights[key], value) for key, value in last.weights.items())


def test_weights_that_are_given_stand_for_the_training_on_synthetic_images(real, synthetic, tmp_path):
    bench = Bench(real_data(real, (), 0.99), {"made": synthetic}, SETTINGS, "cpu")
    alone = bench.train(Cell("made", None, 0), tmp_path / "alone", lambda done, total: None)
    learnt = read_checkpoint(tmp_path / "alone" / "checkpoint.pt")
    still = dataclasses.replace(SETTINGS, schedule=Schedule(0.4, 0.0, 2))  # learning nothing shows where it began
    given = Bench(bench.real, {"learnt": learnt}, still, "cpu")
    only, both = Cell("learnt", None, 3), Cell("learnt", 2, 3)
    found = [given.train(cell, tmp_path / cell.folder, lambda done, total: None) for cell in (only, both)]
    for model in found:
        for key, value in alone.network.state_dict().items():
            assert torch.equal(model.network.state_dict()[key], value)
    assert (given.steps(only), given.steps(both)) == (0, 2)
    assert not (tmp_path / only.folder).exists(), "nothing was trained"
    assert {set_.labelled.name for set_ in given._images(both).datasets} == {"real train"}
    rows = experiment(real, {"learnt": learnt}, tmp_path / "out", dataclasses.replace(SETTINGS, sizes=(2,)))
    assert {row.variant for row in rows} >= {"learnt only", "real", "real + learnt"}
    other = dataclasses.replace(learnt, network={**learnt.network, "base": 3})
    with pytest.raises(MethodError, match="--weights learnt: expected a network of base 4, got base 3; --encoder"):
        Bench(bench.real, {"learnt": other}, SETTINGS, "cpu")


@pytest.mark.parametrize(("kept", "both"), [(0, {"real train": (2, 4)}), (1, {"made": (4, 1), "real train": (2, 3)})])
def test_each_training_sees_its_own_images(real, synthetic, kept, both):
    settings = dataclasses.replace(SETTINGS, schedule=Schedule(0.4, 2e-3, kept))
    bench = Bench(real_data(real, (), 0.99), {"made": synthetic}, settings, "cpu")
    cells = {Cell("made", None, 0): {"made": (4, 4)}, Cell("", 2, 0): {"real train": (2, 4)}, Cell("made", 2, 0): both}
    for cell, expected in cells.items():
        images = bench._images(cell)
        found = {
            dataset.labelled.name: (len(dataset), count)
            for dataset, count in zip(images.datasets, images.counts, strict=True)
        }
        assert found == expected


def test_what_a_cell_is_does_not_depend_on_schedules_of_other_cells(real, synthetic):
    data = real_data(real, (), 0.99)
    benches = [
        Bench(data, {"made": synthetic}, dataclasses.replace(SETTINGS, schedule=schedule), "cpu")
        for schedule in SCHEDULES.values()
    ]
    same = {cell: benches[0].identity(cell) == benches[1].identity(cell) for cell in cells_of(("made",), SETTINGS)}
    assert [cell for cell, equal in same.items() if equal] == [cell for cell in same if not cell.synthetic]


# Running


def test_it_leaves_a_result_for_each_cell_and_goes_on_where_it_was_stopped(real, synthetic, tmp_path, monkeypatch):
    begun = []
    original = work.fit

    def stops(*arguments, **options):
        path = arguments[6]
        if not path.is_file():  # where there is one it is finished, and the training another begins with
            begun.append(path.parent.name)
            if len(begun) == 3:
                raise KeyboardInterrupt
        return original(*arguments, **options)

    monkeypatch.setattr(work, "fit", stops)
    with pytest.raises(KeyboardInterrupt):
        experiment(real, {"made": synthetic}, tmp_path)
    echoed: list[str] = []
    rows = experiment(real, {"made": synthetic}, tmp_path, echoed=echoed)
    assert begun[2] == begun[3], "the one that was interrupted is done again"
    assert len(begun) == 6, "those that were finished are not"
    assert len(list((tmp_path / "cells").glob("*-seed-*/results.json"))) == 5
    assert "5 of 5 trainings are finished" in echoed
    assert [(row.variant, row.images) for row in rows] == [
        ("all", 0), ("none", 0), ("colour", 0), ("made only", 0),
        ("real", 2), ("real + made", 2), ("real", 5), ("real + made", 5),
    ]  # fmt: skip
    records = read_results(tmp_path / "results.json")
    assert {record.sequence for record in records} == {"c", "d", WHOLE}
    assert "IoU of oysters" in (tmp_path / "report.html").read_text()
    assert (tmp_path / "table.md").read_text().count("\n| ") == 10
    again = experiment(real, {"made": synthetic}, tmp_path, train=False)
    assert [row.iou for row in again] == [row.iou for row in rows]


def test_networks_that_tell_live_oysters_from_dead_ones_are_tested_as_others_are(real, tmp_path):
    told = dataclasses.replace(SETTINGS, sizes=(2,), network=dataclasses.replace(SETTINGS.network, states=True))
    rows = experiment(real, {}, tmp_path, told)
    assert "real" in {row.variant for row in rows}
    strong = ExperimentSettings().with_encoder("lite0")
    assert strong.network.states
    begun, alone = Cell("rendered", 5, 0), Cell("rendered", None, 0)
    assert (strong.fit_of(begun).start, strong.fit_of(alone).start) == (0.0, 0.0)
    elsewhere = strong.for_other_sites()
    assert (elsewhere.fit_of(begun).start, elsewhere.fit_of(alone).start) == (0.5, 0.0)
    assert ExperimentSettings().for_other_sites() == ExperimentSettings(sizes=(ALL,)), "no mean of small networks"


def test_a_folder_of_another_experiment_is_refused_by_its_cell(real, synthetic, tmp_path):
    one = dataclasses.replace(SETTINGS, sizes=(2,))
    experiment(real, {}, tmp_path, one)
    more = dataclasses.replace(one, fit=dataclasses.replace(one.fit, steps=6))
    with pytest.raises(ResultError, match="real-real-002-seed-0: holds a cell of other data or settings; --out"):
        experiment(real, {}, tmp_path, more)
    assert len(experiment(real, {"made": synthetic}, tmp_path, one)) == 6, "more variants are no other experiment"


# Scores and the table


def test_the_truth_itself_scores_1_and_trivial_answers_what_cover_and_nothing_are_worth(real):
    test = real.of_split("test")
    truth = Truth.of(test)
    numbers = [np.unique(image.instances, return_inverse=True)[1].reshape(image.instances.shape) for image in test]
    perfect = score(truth, (Prediction(n > 0, n.astype(np.int32), np.ones(n.max())) for n in numbers))
    assert {perfect.metrics[clip]["iou"] for clip in ("c", "d", WHOLE)} == {1.0}
    assert perfect.metrics[WHOLE]["ap_mask"] == pytest.approx(1.0)
    assert perfect.metrics[WHOLE]["count_mae"] == 0
    cover = float(np.mean([image.oysters.mean() for image in test]))
    found = {method.name: score(truth, predictions(method(), truth)).metrics[WHOLE] for method in TRIVIAL}
    assert found["all"]["iou"] == pytest.approx(cover)
    assert found["none"]["iou"] == 0
    assert found["colour"]["iou"] > found["all"]["iou"]


def record(method: str, seed: int, size: int | None, pixels: list[tuple[int, int, int]]) -> ResultRecord:
    """A cell whose images have true and false positives and misses, half of them in each of two clips."""
    keys = ("true_positive", "false_positive", "false_negative")
    images = [
        {"name": f"{k}", "clip": "c" if k < len(pixels) / 2 else "d", **dict(zip(keys, row, strict=True))}
        for k, row in enumerate(pixels)
    ]
    metrics = dict.fromkeys(("iou", "ap_mask", "ap50_mask", "count_mae", "count_bias", "boundary_iou"), 0.5)
    return ResultRecord(
        track="segmentation",
        split="real test",
        sequence=WHOLE,
        method=method,
        method_settings={"real_images": size or 0, "asked": size},
        seed=seed,
        run=seed,
        metrics={**metrics, "precision": 0.5, "recall": 0.5},
        info={"images": images},
    )


def test_rows_pool_pixels_average_seeds_and_pair_gains_over_the_same_images():
    rng = np.random.default_rng(0)
    base = [[tuple(int(v) for v in rng.integers(10, 90, 3)) for _ in range(16)] for _ in range(2)]
    better = [[(tp + 5, fp, fn - 5) for tp, fp, fn in seed] for seed in base]
    records = [record("real", k, 10, base[k]) for k in range(2)]
    records += [record("real + made", k, 10, better[k]) for k in range(2)]
    rows = {row.variant: row for row in variants(records, block=2)}
    pooled = [np.sum(seed, axis=0) for seed in base]
    expected = np.mean([sums[0] / sums.sum() for sums in pooled])
    assert rows["real"].iou == pytest.approx(expected)
    assert rows["real"].interval.low < expected < rows["real"].interval.high
    gain = rows["real + made"]
    assert gain.gain == pytest.approx(rows["real + made"].iou - rows["real"].iou)
    assert gain.gain_interval.low > 0, "better on each image is better, however much images differ"
    assert rows["real"].gain is None
    # The interval by hand: blocks of two images, drawn as often as the named stream says.
    blocks = np.array(base).reshape(2, 8, 2, 3).sum(axis=2)
    drawn_blocks = resample_counts(8)
    each = np.array([(drawn_blocks @ b[:, 0]) / (drawn_blocks @ b.sum(axis=1)) for b in blocks])
    values = np.concatenate([each.mean(axis=0), each.mean(axis=0), *each])  # of two seeds, both or twice the same
    assert np.quantile(values, 0.5) == pytest.approx(expected, abs=0.02)
    assert rows["real"].interval.high - rows["real"].interval.low < 6 * values.std()


def test_seeds_that_differ_widen_the_interval_as_images_that_differ_do():
    alike = [record("real", k, 10, [(10, 5, 5)] * 16) for k in range(4)]
    apart = [record("real", k, 10, [(8 + k, 5, 7 - k)] * 16) for k in range(4)]
    (one,), (other,) = variants(alike, block=2), variants(apart, block=2)
    assert one.interval.low == one.interval.high == pytest.approx(0.5)
    assert other.interval.low < other.iou - 0.01
    assert other.interval.high > other.iou + 0.01
    shifted = [record("real + made", k, 10, [(10 + k, 5, 5 - k)] * 16) for k in range(4)]
    gain = next(row for row in variants([*apart, *shifted], block=2) if row.gain is not None)
    assert gain.gain_interval.low == gain.gain_interval.high == pytest.approx(0.1), "gains are paired by seed"


def test_too_few_blocks_have_no_interval_and_the_table_says_none():
    rows = variants([record("real", 0, 5, [(10, 5, 5)] * 4)], block=2)
    assert not rows[0].interval.known
    assert table_of(rows).texts[0][3] == "0.500"
    assert plot(rows).startswith("<svg")


def test_every_variant_has_a_curve_of_its_own_that_begins_with_its_synthetic_images_alone():
    names = [f"set{k}" for k in range(6)]
    records = [record("all", 0, None, [(1, 1, 0)] * 4)]
    for name in names:
        records += [record(f"{name} only", 0, None, [(10, 5, 5)] * 4)]
    for variant in ("real", *(f"real + {name}" for name in names)):
        records += [record(variant, 0, size, [(10, 5, size)] * 4) for size in (10, 5)]
    rows = variants(records, block=2)
    drawn = plot(rows)
    curves = curves_of(rows)
    assert list(curves) == ["real", *(f"real + {name}" for name in names)]
    assert [row.images for row in curves["real"]] == [5, 10]
    assert [row.size for row in curves["real + set3"]] == [None, 5, 10]
    assert all(variant in drawn for variant in curves)


def test_synthetic_sets_of_one_name_are_joined(real, tmp_path, monkeypatch):
    monkeypatch.setattr(data, "near_duplicates", lambda *sets: [])  # these small pictures are all alike
    for k, name in enumerate(("one", "other")):
        small_set(tmp_path / name, {"s": ("", 2)}, first=60 + 10 * k)
    both = [f"--synthetic=made={tmp_path / name}" for name in ("one", "other")]
    place = Path(real.entries[0].files[0]).parents[1]
    options = [f"--real={place}", *both, f"--out={tmp_path / 'out'}", "--sizes=2", "--seeds=1", "--only-table"]
    done = CliRunner().invoke(command, options, catch_exceptions=False)
    assert done.exit_code == 0
    assert "0 of 3 trainings are finished" in done.stderr, "made only, real, real + made"
    with pytest.raises(LabelError, match="two images are named"):
        CliRunner().invoke(command, [*options, both[0]], catch_exceptions=False)


def test_sizes_of_which_there_are_no_images_are_left_out_by_name(real, tmp_path):
    sizes = dataclasses.replace(SETTINGS, sizes=(2, 40, 500))
    echoed = []
    experiment(real, {}, tmp_path, sizes, echoed, train=False)
    assert "left out: sizes 40, 500, as there are 5 real images to train on" in echoed
    assert "left out: sizes 40, 500" in (tmp_path / "report.html").read_text()
    echoed.clear()
    experiment(real, {}, tmp_path, dataclasses.replace(SETTINGS, sizes=(5, ALL)), echoed, train=False)
    assert not any("left out: size" in str(line) for line in echoed)


def test_size_0_trains_on_synthetic_images_alone(real, synthetic, tmp_path, monkeypatch):
    monkeypatch.setattr(data, "near_duplicates", lambda *sets: [])
    real, made = (Path(labelled.entries[0].files[0]).parents[1] for labelled in (real, synthetic))
    for sizes, cells in (("0", 2), ("0,2", 6)):
        options = [f"--real={real}", f"--synthetic=made={made}", f"--out={tmp_path / 'out'}", f"--sizes={sizes}"]
        done = CliRunner().invoke(command, [*options, "--seeds=2", "--only-table"], catch_exceptions=False)
        assert f"0 of {cells} trainings are finished" in done.stderr
    done = CliRunner().invoke(command, [f"--real={real}", "--sizes=-1,x"])
    assert done.exit_code == 2
    assert "expected whole numbers, and all, with commas, got '-1,x'" in done.output


def test_weights_are_given_by_a_name_of_their_own(real, tmp_path, monkeypatch):
    place = Path(real.entries[0].files[0]).parents[1]
    done = CliRunner().invoke(command, [f"--real={place}", "--weights=real=w.pt"])
    assert done.exit_code == 2
    assert "--weights: expected NAME=MODEL|FILE, with a name other than real, got 'real=w.pt'" in done.output
    with pytest.raises(MethodError, match="no such checkpoint"):
        CliRunner().invoke(command, [f"--real={place}", f"--weights=w={tmp_path / 'w.pt'}"], catch_exceptions=False)
    monkeypatch.setenv("OYSTERBENCH_UNET", str(tmp_path / "mine.pt"))
    with pytest.raises(MethodError, match=r"unet: no trained weights at .*mine\.pt"):
        CliRunner().invoke(command, [f"--real={place}", "--weights=w=unet"], catch_exceptions=False)
