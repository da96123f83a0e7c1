"""The training: it learns, repeats itself, survives a kill, and refuses what it cannot learn from."""

from __future__ import annotations

import csv
import multiprocessing
import os
import signal
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import cv2  # noqa: E402
from click.testing import CliRunner  # noqa: E402

from oysterbench.annotations import open_labelled, write_folder  # noqa: E402
from oysterbench.core.errors import LabelError, MethodError  # noqa: E402
from oysterbench.core.streams import Streams  # noqa: E402
from oysterbench_baselines.cut.command import cut_command, reinhard_command, targets, train_command  # noqa: E402
from oysterbench_baselines.cut.sheets import sample_sheet, write_curves  # noqa: E402
from oysterbench_baselines.cut.training import TERMS, Adversaries, curves, train  # noqa: E402
from oysterbench_baselines.cut.translation import load_generator, translate  # noqa: E402
from oysterbench_baselines.learning.card import describe  # noqa: E402
from tests.baselines.test_cut_parts import TINY, labelled, reef  # noqa: E402

STEPS = 6
SETTINGS = {
    "cut": replace(TINY, skip=True, steps=STEPS, learning_rate=1e-3),
    "fastcut": replace(
        TINY, skip=True, steps=STEPS, learning_rate=1e-3, nce_weight=10.0, identity=False, flip=True, scale=0.5
    ),
}
SOURCE, TARGET = labelled(20), labelled(20, "real", tint=70)


def learn(path, settings, **more):
    return train(SOURCE, TARGET, settings, path, seed=3, **more)


def same(one, other):
    return all(
        torch.equal(one.weights[part][name], other.weights[part][name])
        for part in one.weights
        for name in one.weights[part]
    )


@pytest.mark.parametrize(
    "method", [pytest.param(one, marks=pytest.mark.slow) if one == "cut" else one for one in SETTINGS]
)
@pytest.mark.slow
def test_trained_twice_the_weights_are_the_same(tmp_path, method):
    one, other = (learn(tmp_path / name, SETTINGS[method]) for name in ("a.pt", "b.pt"))
    assert same(one, other)
    assert one.losses == other.losses
    assert not same(one, train(SOURCE, TARGET, SETTINGS[method], tmp_path / "c.pt", seed=4))


@pytest.mark.parametrize("method", SETTINGS)
def test_a_training_that_was_stopped_at_every_step_is_the_same(tmp_path, method):
    whole = learn(tmp_path / "whole.pt", SETTINGS[method])

    class Stop(Exception):
        pass

    def stop(checkpoint):
        if not checkpoint.finished:
            raise Stop

    path = tmp_path / "parts.pt"
    for _ in range(STEPS - 1):
        with pytest.raises(Stop):
            learn(path, SETTINGS[method], keep=stop, keep_s=0.0)
    parts = learn(path, SETTINGS[method])
    assert same(whole, parts)
    assert whole.losses == parts.losses


def killed(path):
    def kill(checkpoint):
        if checkpoint.step == 3:
            os.kill(os.getpid(), signal.SIGKILL)

    learn(path, SETTINGS["fastcut"], keep=kill, keep_s=0.0)


@pytest.mark.slow
def test_a_killed_training_goes_on_to_the_same_weights(tmp_path):
    whole = learn(tmp_path / "whole.pt", SETTINGS["fastcut"])
    path = tmp_path / "killed.pt"
    process = multiprocessing.get_context("spawn").Process(target=killed, args=(path,))
    process.start()
    process.join(120)
    assert process.exitcode == -signal.SIGKILL
    assert same(whole, learn(path, SETTINGS["fastcut"]))


def test_a_finished_training_is_not_done_again(tmp_path):
    path = tmp_path / "done.pt"
    learn(path, SETTINGS["fastcut"])
    before = path.stat().st_mtime_ns
    steps = []
    learn(path, SETTINGS["fastcut"], progress=lambda done, total: steps.append(done))
    assert not steps
    assert path.stat().st_mtime_ns == before


def test_another_training_is_not_gone_on_with(tmp_path):
    learn(tmp_path / "a.pt", SETTINGS["fastcut"])
    with pytest.raises(MethodError, match="holds a training with scale = "):
        learn(tmp_path / "a.pt", SETTINGS["cut"])
    with pytest.raises(MethodError, match="holds a training with target = "):
        train(SOURCE, labelled(21, "real"), SETTINGS["fastcut"], tmp_path / "a.pt", seed=3)


@pytest.mark.slow
def test_patches_find_themselves_again_and_colours_come_nearer(tmp_path):
    """On the mean of two trainings: the last bits of sums are the processor's, and adversaries make them grow, so that
    one of them alone ends 6 to 116 bluer."""
    settings = replace(SETTINGS["cut"], steps=100, learning_rate=2e-3, identity=False)
    picture = SOURCE[0].pixels
    shares, shifts = [], []
    for seed in (1, 2):
        path = tmp_path / f"{seed}.pt"
        found = curves(train(SOURCE, TARGET, settings, path, seed=seed))
        assert found.shape == (100, len(TERMS))
        content = found[:, TERMS.index("content")]
        shares.append(content[-20:].mean() / content[:20].mean())
        translated = translate(load_generator(path)[0], settings, picture)
        shifts.append(translated[..., 2].astype(float).mean() - picture[..., 2].astype(float).mean())
    assert np.mean(shares) < 0.9
    assert np.mean(shifts) > 10, "towards the target, which is bluer by 70"


def test_a_mirrored_translation_is_held_to_the_places_of_its_original():
    """By their pixels, which mirror exactly: the loss is that of the same picture, not mirrored."""
    trainer = Adversaries(replace(TINY, layers=("pixels",)), Streams(0), torch.device("cpu"))
    picture, translated = (torch.from_numpy(reef(k)[0].transpose(2, 0, 1)[None].copy()) / 127.5 - 1 for k in (0, 1))
    plain = float(trainer._content(translated, picture, ("a", 0)).detach())
    assert float(trainer._content(translated.flip(3), picture, ("a", 0), mirrored=True).detach()) == pytest.approx(
        plain
    )
    assert float(trainer._content(translated.flip(3), picture, ("a", 0)).detach()) != pytest.approx(plain)


def test_a_loss_that_is_not_finite_stops_the_training_by_name():
    trainer = Adversaries(SETTINGS["fastcut"], Streams(0), torch.device("cpu"))
    with torch.no_grad():
        next(trainer.discriminator.parameters()).fill_(float("nan"))
    picture = torch.zeros(1, 3, 32, 32)
    with pytest.raises(MethodError, match=r"not finite after 0 steps \(discriminator nan"):
        trainer.turn(picture, picture + 0.1, 0)


def test_a_checkpoint_of_something_else_is_refused(tmp_path):
    path = tmp_path / "a.pt"
    path.write_bytes(b"no checkpoint")
    with pytest.raises(MethodError, match="not a checkpoint"):
        load_generator(path)
    with pytest.raises(MethodError, match="no such checkpoint"):
        load_generator(tmp_path / "none.pt")


def test_curves_are_a_table_and_a_picture(tmp_path):
    checkpoint = learn(tmp_path / "a.pt", SETTINGS["cut"])
    write_curves(checkpoint, tmp_path)
    rows = list(csv.reader((tmp_path / "losses.csv").read_text().splitlines()))
    assert rows[0] == ["step", *TERMS]
    assert len(rows) == STEPS + 1
    assert [float(v) for v in rows[3][1:]] == pytest.approx(curves(checkpoint)[2], rel=1e-4)
    picture = cv2.imread(str(tmp_path / "losses.png"))
    assert (picture < 200).any(axis=2).sum() > 500, "there is something to see"


def test_a_sample_sheet_has_the_outlines_and_the_nearest_real_picture():
    image = SOURCE[0]
    far, near = np.zeros_like(image.pixels), image.pixels + np.uint8(1)
    pictures = sample_sheet([image], [image.pixels], [far, near])
    assert (pictures == near[50, 50]).all(axis=2).any()
    assert (pictures == (255, 230, 0)).all(axis=2).sum() > 50


@pytest.fixture
def folders(tmp_path):
    """Rendered and real pictures as folders of masks; the last six real ones are for testing."""
    for name, images in (("rendered", labelled(20)), ("real", labelled(30, "real", tint=70, clips=5))):
        sides = {entry.name: "test" if entry.clip == "clip-4" else "train" for entry in images.entries}
        write_folder(images, tmp_path / name, sides if name == "real" else None)
    return tmp_path


def test_only_what_is_for_training_is_a_target(folders):
    real = open_labelled(folders / "real")
    assert targets(real, None, ()).clips == ("clip-0", "clip-1", "clip-2", "clip-3")
    assert targets(real, None, ("clip-1",)).clips == ("clip-1",)
    with pytest.raises(LabelError, match="--clip clip-4"):
        targets(real, None, ("clip-4",))


def test_where_no_side_is_for_training_what_is_scored_is_no_target_and_that_is_said(tmp_path, capsys):
    images = labelled(4, clips=2)
    sides = {entry.name: "test" if entry.clip == "clip-1" else "val" for entry in images.entries}
    write_folder(images, tmp_path, sides)
    found = targets(open_labelled(tmp_path), None, ())
    assert found.splits == ("val",)
    assert len(found) == 2
    assert "2 of 4 images are used, all but the side test" in capsys.readouterr().err
    assert targets(open_labelled(tmp_path), "test", ()).splits == ("test",)
    with pytest.raises(LabelError, match="no image of split 'test'; its splits: none"):
        targets(images, "test", ())


def run(command, *arguments):
    return CliRunner().invoke(command, [str(a) for a in arguments], catch_exceptions=False)


def test_the_controls_write_folders_that_can_be_trained_on(folders):
    out = folders / "recoloured"
    done = run(reinhard_command, "--source", folders / "rendered", "--target", folders / "real", "--out", out)
    assert done.exit_code == 0
    assert "mask drift, medians of 20 images" in done.stderr
    found, before = open_labelled(out), open_labelled(folders / "rendered")
    assert [entry.name for entry in found.entries] == [entry.name for entry in before.entries]
    assert np.array_equal(found[7].oysters, before[7].oysters)
    assert found[7].pixels[..., 2].mean() > before[7].pixels[..., 2].mean() + 30


def test_translated_images_stay_on_their_sides(folders):
    out = folders / "recoloured"
    options = ("--target", folders / "real", "--out", out)
    assert run(reinhard_command, "--source", folders / "real", *options).exit_code == 0
    before = {entry.name: entry.split for entry in open_labelled(folders / "real").entries}
    assert {entry.name: entry.split for entry in open_labelled(out).entries} == before
    assert {*before.values()} == {"train", "test"}
    kept = (out / "manifest.csv").read_bytes()
    with pytest.raises(MethodError, match=r"got none for rendered/reef-0, and train, test for others"):
        run(reinhard_command, "--source", folders / "rendered", "--source", folders / "real", *options)
    assert (out / "manifest.csv").read_bytes() == kept


def test_the_commands_train_and_translate(folders, monkeypatch):
    from oysterbench_baselines.cut import settings

    monkeypatch.setitem(settings.SIZES, "small", replace(TINY, skip=True, steps=4))
    place = ("--source", folders / "rendered", "--target", folders / "real")
    done = run(train_command, *place, "--out", folders / "cut", "--method", "cut")
    assert done.exit_code == 0
    assert {path.name for path in (folders / "cut").iterdir()} == {
        "checkpoint.pt",
        "losses.csv",
        "losses.png",
        "samples",
    }
    assert [path.name for path in (folders / "cut" / "samples").iterdir()] == ["000004.png"]
    out = folders / "translated"
    done = run(cut_command, folders / "cut" / "checkpoint.pt", "--source", folders / "rendered", "--out", out)
    assert done.exit_code == 0
    assert len(open_labelled(out)) == 20
    assert open_labelled(out)[0].pixels.shape == reef(0)[0].shape


def test_translating_without_a_checkpoint_takes_the_weights_that_a_download_leaves(folders, home):
    train(SOURCE, TARGET, replace(TINY, skip=True, steps=2), home / "models" / "cut.pt")
    assert list(describe("cut", home / "models" / "cut.pt").data) == ["source", "target"]
    done = run(cut_command, "--source", folders / "rendered", "--out", folders / "by-default")
    assert done.exit_code == 0
    assert len(open_labelled(folders / "by-default")) == 20
    (home / "models" / "cut.pt").unlink()
    with pytest.raises(MethodError, match="cut: no trained weights at"):
        run(cut_command, "--source", folders / "rendered", "--out", folders / "none")
    assert not (folders / "none").exists()


def test_too_few_pictures_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(LabelError, match="at least 20 images"):
        train(labelled(5), TARGET, SETTINGS["cut"], tmp_path / "a.pt")
    assert not list(tmp_path.iterdir())


def test_several_sources_are_translated_into_one_folder(folders):
    write_folder(labelled(3, "more"), folders / "more")
    out = folders / "both"
    sources = ("--source", folders / "rendered", "--source", folders / "more")
    assert run(reinhard_command, *sources, "--target", folders / "real", "--out", out).exit_code == 0
    names = [entry.name for entry in open_labelled(out).entries]
    assert len(names) == 23
    assert {name.split("-")[0] for name in names} == {"rendered", "more"}
