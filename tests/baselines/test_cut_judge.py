"""A judge of label drift: it counts what has vanished and appeared, and leaves out what it no longer recognises."""

import csv
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import cv2  # noqa: E402
from click.testing import CliRunner  # noqa: E402

from oysterbench.annotations import open_labelled, write_folder  # noqa: E402
from oysterbench.core.errors import LabelError, MethodError  # noqa: E402
from oysterbench_baselines.cut.command import reinhard_command  # noqa: E402
from oysterbench_baselines.cut.judge import Judge, Verdict, compare, together  # noqa: E402
from oysterbench_baselines.cut.writing import FILE, sentences, write_translated  # noqa: E402
from oysterbench_baselines.unet.training import train  # noqa: E402
from tests.baselines.test_cut_parts import labelled  # noqa: E402
from tests.helpers.small_trainings import SMALL  # noqa: E402

GROUND = (70, 90, 60)
"""RGB, mean of what is no oyster in the pictures of `labelled`."""


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Of a network that tells bright ellipses from dark ground."""
    path = tmp_path_factory.mktemp("judge") / "unet.pt"
    train(labelled(12), path, replace(SMALL, fit=replace(SMALL.fit, steps=40)), 1, torch.device("cpu"))
    return path


@pytest.fixture(scope="module")
def judge(weights):
    return Judge(weights)


def left(image):
    """(H, W): the oysters of its left half."""
    return image.oysters & (np.arange(image.pixels.shape[1]) < image.pixels.shape[1] // 2)


def painted_over(image):
    """Without the oysters of its left half."""
    noise = np.random.default_rng(0).normal(GROUND, 6, image.pixels.shape)
    pixels = np.where(left(image)[..., None], cv2.GaussianBlur(noise, (0, 0), 0.8), image.pixels)
    return replace(image, pixels=pixels.astype(np.uint8))


def painted_upon(image):
    """With another oyster, where there is most room for it."""
    free = cv2.distanceTransform((~image.oysters).astype(np.uint8), cv2.DIST_L2, 3)
    row, column = np.unravel_index(int(free.argmax()), free.shape)
    pixels = image.pixels.copy()
    colour = [level + more for level, more in zip(GROUND, (60, 50, 55), strict=True)]
    cv2.circle(pixels, (int(column), int(row)), int(min(14, free.max())), colour, -1)
    return replace(image, pixels=pixels)


def test_what_is_counted_is_what_was_written_out_by_hand():
    labels = np.array([[1, 1, 1, 0, 0, 0, 1, 0]], bool)
    before = np.array([[1, 1, 0, 1, 0, 0, 1, 0]], bool)
    after = np.array([[1, 0, 1, 1, 1, 0, 0, 1]], bool)
    ignored = np.array([[0, 0, 0, 0, 0, 0, 1, 1]], bool)
    found = compare(labels, ignored, before, after)
    assert found == Verdict(3, 3, hits=2, false=1, hits_after=2, false_after=2, vanished=1, appeared=1)
    assert (found.iou, found.iou_after) == (2 / 4, 2 / 5)
    assert (found.vanished_share, found.appeared_share) == (1 / 2, 1 / 2)
    assert found.holds(0.8)
    assert not found.holds(0.81)
    whole = together([found, found, compare(~labels & False, ignored, before & False, after)])
    assert whole.labelled == 6
    assert whole.appeared == 2 + 4


def test_pictures_without_oysters_say_nothing_and_are_kept():
    nothing = np.zeros((4, 4), bool)
    found = compare(nothing, nothing, nothing, nothing)
    assert np.isnan([found.iou, found.iou_after, found.vanished_share]).all()
    assert found.appeared_share == 0
    assert found.holds(1.0)
    assert compare(nothing, nothing, nothing, ~nothing).holds(1.0)


def test_the_same_picture_loses_nothing(judge):
    image = labelled(20)[15]
    found = judge.verdict(image, image)
    assert found.iou > 0.7, "it has learnt what it is to judge by"
    assert found.iou_after == found.iou
    assert (found.vanished, found.appeared) == (0, 0)


def test_an_oyster_that_is_painted_over_has_vanished_and_a_new_one_has_appeared(judge):
    image = labelled(20)[15]
    gone, new = judge.verdict(image, painted_over(image)), judge.verdict(image, painted_upon(image))
    assert gone.vanished == pytest.approx(np.count_nonzero(left(image) & judge.sees(image.pixels)), rel=0.1)
    assert gone.appeared_share < 0.02
    assert new.appeared > 100
    assert new.vanished_share < 0.05


def rows(folder):
    lines = (folder / FILE).read_text().splitlines()
    columns = lines[0].split(",")
    assert len({*columns}) == len(columns)
    return {row["id"]: row for row in csv.DictReader(lines)}


def test_images_on_which_the_labels_no_longer_hold_are_left_out(judge, tmp_path):
    source = labelled(6)

    def change(images):
        for k, image in enumerate(images):
            yield painted_over(image) if k in (1, 4) else image

    steps = []
    write_translated(source, lambda images: iter(images), tmp_path, None, 0.0, lambda done, total: None)
    assert len(open_labelled(tmp_path)) == 6
    assert {row["iou"] for row in rows(tmp_path).values()} == {""}
    found = write_translated(source, change, tmp_path, judge, 0.8, lambda done, total: steps.append((done, total)))
    assert steps == [(k, 6) for k in range(1, 7)]
    assert [entry.name for entry in open_labelled(tmp_path).entries] == ["reef-0", "reef-2", "reef-3", "reef-5"]
    assert not (tmp_path / "images" / "reef-1.png").exists(), "which the first translation had left there"
    table = rows(tmp_path)
    assert [table[f"reef-{k}"]["written"] for k in range(6)] == ["1", "0", "1", "1", "0", "1"]
    assert float(table["reef-1"]["vanished"]) > 0.2
    assert float(table["reef-0"]["iou"]) == float(table["reef-0"]["iou_after"])
    *_, judged, left_out = sentences(found)
    assert judged.startswith("the judge, over 6 images: IoU with the labels 0.")
    assert left_out.startswith("left out: 2 of 6 images")


def test_a_translation_of_which_nothing_is_left_is_an_error(judge, tmp_path):
    with pytest.raises(MethodError, match=r"on all 3 images the judge's IoU fell below 1 of what it was"):
        write_translated(
            labelled(3), lambda images: map(painted_over, images), tmp_path, judge, 1.0, lambda done, total: None
        )
    assert len(rows(tmp_path)) == 3


def bytes_in(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("earlier", [False, True])
def test_labelled_images_of_ones_own_are_never_written_over(tmp_path, earlier):
    mine, other = tmp_path / "mine", tmp_path / "other"
    for folder in (mine, other):
        write_folder(labelled(3), folder)
    if earlier:  # a translation that is itself to be translated
        (mine / FILE).write_text("id\n")
    before = bytes_in(mine)
    why = "holds .*reef-0.png, which is to be" if earlier else "expected a new folder, .* got one with images"
    for source in (mine,) if earlier else (mine, other):
        with pytest.raises(MethodError, match=f"{why}.*left unchanged.*choose another --out"):
            write_translated(open_labelled(source), iter, mine, None, 0.0, lambda done, total: None)
        assert bytes_in(mine) == before


def test_a_translation_that_was_interrupted_can_be_repeated(tmp_path):
    def stop(images):
        yield next(iter(images))
        raise KeyboardInterrupt

    def stop_at_once(images):
        raise KeyboardInterrupt

    def refused(folder):
        with pytest.raises(LabelError, match=r"manifest.csv: lists no image: .*interrupted, .*run that again"):
            open_labelled(folder)

    with pytest.raises(KeyboardInterrupt):
        write_translated(labelled(3), stop, tmp_path / "out", None, 0.0, lambda done, total: None)
    refused(tmp_path / "out")
    write_translated(labelled(3), iter, tmp_path / "out", None, 0.0, lambda done, total: None)
    assert len(open_labelled(tmp_path / "out")) == len(rows(tmp_path / "out")) == 3
    whole = bytes_in(tmp_path / "out")
    with pytest.raises(KeyboardInterrupt):
        write_translated(labelled(3), stop_at_once, tmp_path / "out", None, 0.0, lambda done, total: None)
    assert bytes_in(tmp_path / "out") == whole, "images that are still there, and their measurements"
    with pytest.raises(KeyboardInterrupt):
        write_translated(labelled(3), stop, tmp_path / "out", None, 0.0, lambda done, total: None)
    assert rows(tmp_path / "out") == {}, "no measurements of images that were there before"
    refused(tmp_path / "out")


def test_the_commands_take_a_judge(weights, tmp_path, home):
    write_folder(labelled(6), tmp_path / "rendered")
    write_folder(labelled(6, "real", tint=20), tmp_path / "real")
    place = ["--source", str(tmp_path / "rendered"), "--target", str(tmp_path / "real"), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(reinhard_command, [*place, "--judge", str(weights)], catch_exceptions=False)
    assert done.exit_code == 0
    assert "the judge, over 6 images" in done.stderr
    assert all(float(row["iou"]) > 0.5 for row in rows(tmp_path / "out").values())
    refused = CliRunner().invoke(reinhard_command, [*place, "--keep", "0.8"])
    assert refused.exit_code == 2
    assert "expected --judge beside it" in refused.stderr
    with pytest.raises(MethodError, match="no trained weights at"):
        CliRunner().invoke(reinhard_command, [*place, "--judge", str(tmp_path / "absent.pt")], catch_exceptions=False)
    released = CliRunner().invoke(reinhard_command, [*place, "--judge", "unet"], catch_exceptions=False)
    assert "the judge, over 6 images" in released.stderr, "the weights that are part of oysterbench"
    wrong = tmp_path / "wrong.pt"
    wrong.write_bytes(b"no checkpoint")
    with pytest.raises(MethodError, match="not a checkpoint"):
        CliRunner().invoke(reinhard_command, [*place, "--judge", str(wrong)], catch_exceptions=False)
