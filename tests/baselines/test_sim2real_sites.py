"""Each site tested on by what was trained on all others."""

from __future__ import annotations

import contextlib
import dataclasses

import numpy as np
import pytest
from click.testing import CliRunner

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from oysterbench.core.errors import LabelError  # noqa: E402
from oysterbench.results.records import read_results  # noqa: E402
from oysterbench_baselines.sim2real import work  # noqa: E402
from oysterbench_baselines.sim2real.command import command  # noqa: E402
from oysterbench_baselines.sim2real.data import site_data, sites_of  # noqa: E402
from oysterbench_baselines.sim2real.experiment import run_sites  # noqa: E402
from oysterbench_baselines.sim2real.settings import SCHEDULES, ExperimentSettings  # noqa: E402
from oysterbench_baselines.sim2real.sites import site_rows, sites_table  # noqa: E402
from tests.baselines.test_sim2real import SETTINGS, record  # noqa: E402
from tests.helpers.small_trainings import small_set  # noqa: E402

CLIPS = {"bay-a": ("train", 3), "bay-b": ("test", 2), "pier": ("train", 3), "reef": ("test", 3)}


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """Four clips, of which two show one place: an image of one is in the other under another name."""
    folder = tmp_path_factory.mktemp("sites") / "real"
    labelled = small_set(folder, CLIPS)
    (folder / "images" / "bay-b-3.png").write_bytes((folder / "images" / "bay-a-1.png").read_bytes())
    return labelled


@pytest.fixture(scope="module")
def synthetic(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("synthetic") / "made", {"s": ("", 4)}, first=50)


def experiment(real, synthetic, out, echoed=None, **options):
    return run_sites(
        real,
        {"made": synthetic},
        SETTINGS,
        out,
        **{"device": "cpu", "train": True, **options},
        bar=lambda title, unit: contextlib.nullcontext(lambda done, total: None),
        echo=([] if echoed is None else echoed).append,
        show=lambda table: None,
    )


def test_clips_that_share_an_image_are_one_site(real):
    assert sites_of(real, 0.99) == {"bay": ("bay-a", "bay-b"), "pier": ("pier",), "reef": ("reef",)}


def test_a_site_is_tested_on_whole_and_no_image_of_it_is_trained_on(real):
    found = site_data(real, ("bay-a", "bay-b"), 1.01)
    assert (found.test.clips, found.train.clips) == (("bay-a", "bay-b"), ("pier", "reef"))
    assert len(found.test) == 5
    with pytest.raises(LabelError, match="expected clips of bay-a, bay-b, pier, reef, got 'harbour'"):
        site_data(real, ("harbour",), 0.99)


def test_every_site_has_its_trainings_and_what_is_synthetic_alone_is_trained_once(
    real, synthetic, tmp_path, monkeypatch
):
    trained = []
    original = work.fit

    def counted(*arguments, **options):
        if not arguments[6].is_file():
            trained.append(str(arguments[6].parent.relative_to(tmp_path)))
        return original(*arguments, **options)

    monkeypatch.setattr(work, "fit", counted)
    echoed: list[str] = []
    rows = experiment(real, synthetic, tmp_path, echoed)
    of_sites = [f"{site}/{kind}-real-all-seed-0" for site in ("bay", "pier", "reef") for kind in ("real", "made")]
    assert sorted(trained) == sorted(["synthetic/made-real-none-seed-0", *of_sites])
    assert [row.variant for row in rows] == ["all", "none", "colour", "made only", "real", "real + made"]
    assert all(list(row.iou) == ["bay", "pier", "reef"] for row in rows)
    assert "9 of 9 trainings are finished" in echoed
    by_name = {row.variant: row for row in rows}
    both, alone = by_name["real + made"], by_name["real"]
    assert both.gain == pytest.approx({site: both.iou[site] - alone.iou[site] for site in both.iou})
    assert both.mean_gain == pytest.approx(both.mean - alone.mean)
    assert alone.mean_gain is None
    assert {one.sequence for one in read_results(tmp_path / "results.json")} == {*CLIPS, "all clips"}
    assert (tmp_path / "table.md").read_text().count("\n| ") == 8
    # Again: nothing is trained, and the table is the same.
    trained.clear()
    again = experiment(real, synthetic, tmp_path, train=False)
    assert [row.iou for row in again] == [row.iou for row in rows]
    assert trained == []


def test_gains_are_paired_and_their_mean_is_of_sites_however_many_images_these_have():
    rng = np.random.default_rng(0)
    base = {site: [tuple(int(v) for v in rng.integers(20, 90, 3)) for _ in range(n)] for site, n in SIZES.items()}
    step = {"large": 4, "small": 16}
    records = {
        site: [
            record(method, seed, 0, [(tp + more, fp, fn - more) for tp, fp, fn in base[site]])
            for seed in range(2)
            for method, more in (("real", 0), ("real + made", step[site]))
        ]
        for site in SIZES
    }
    rows = {row.variant: row for row in site_rows(records, block=2)}
    gained = rows["real + made"]
    for site, more in step.items():
        tp, fp, fn = np.sum(base[site], axis=0)
        assert gained.gain[site] == pytest.approx(len(base[site]) * more / (tp + fp + fn))
    assert gained.mean_gain == pytest.approx(np.mean(list(gained.gain.values())))
    assert gained.gain["small"] > 2 * gained.gain["large"]
    assert 0 < gained.interval.low < gained.mean_gain < gained.interval.high
    assert gained.seeds == 2
    assert [column.heading for column in sites_table(list(rows.values())).columns][2:4] == ["large", "small"]


SIZES = {"large": 24, "small": 12}


def test_of_a_site_with_few_blocks_no_interval_is_made_up():
    records = {
        site: [
            record(method, 0, 0, [(50 + more + k % 3, 20, 20 - more) for k in range(count)])
            for method, more in (("real", 0), ("real + made", 4))
        ]
        for site, count in (("large", 24), ("small", 4))
    }
    (gained,) = (row for row in site_rows(records, block=2) if row.interval is not None)
    assert gained.mean_gain > 0
    assert not gained.interval.known
    assert gained.interval.reason == "small: 2 blocks: no 95% interval is possible with fewer than 6"


def test_a_training_that_one_site_lacks_has_no_row():
    records = {"a": [record("real", 0, 0, [(5, 5, 5)] * 4), record("real + made", 0, 0, [(6, 5, 5)] * 4)]}
    records["b"] = records["a"][:1]
    assert [row.variant for row in site_rows(records, block=2)] == ["real"]


def test_one_site_alone_cannot_be_left_out_and_holding_out_besides_is_refused(real, synthetic, tmp_path):
    one = real.where(lambda entry: entry.clip == "pier")
    with pytest.raises(LabelError, match="expected clips of two sites at least, got pier"):
        experiment(one, synthetic, tmp_path)
    done = CliRunner().invoke(command, ["--real", str(tmp_path), "--leave-site-out", "--hold-out", "pier"])
    assert done.exit_code == 2
    assert "expected no --hold-out beside it" in done.output


@pytest.mark.parametrize("schedule", SCHEDULES)
def test_an_encoder_changes_the_networks_and_the_steps_and_nothing_of_what_is_compared(schedule):
    weak = ExperimentSettings(schedule=SCHEDULES[schedule], seeds=5, sizes=(5,))
    strong = weak.with_encoder("lite0")
    assert strong.network.encoder == "lite0"
    assert strong.fit.steps < weak.fit.steps
    assert strong.schedule.kept == weak.schedule.kept
    assert (
        dataclasses.replace(
            strong,
            **{key: getattr(weak, key) for key in ("batch", "schedule", "network", "augmentation", "fit")},
        )
        == weak
    )
