"""Data that a training command is given: of a folder with sides only that to train on, of others everything."""

from __future__ import annotations

import json

import numpy as np
import pytest

from oysterbench.annotations import LabelledSet, write_folder
from oysterbench.cli.labelled import open_training_data
from oysterbench.core.errors import LabelError
from tests.helpers.labelled_folders import image, write_png


@pytest.fixture
def folder(tmp_path):
    """Make a folder of two images, on the given sides."""

    def make(name: str, *sides: str) -> str:
        images = [image(k, "clip", 48, 48) for k in range(len(sides))]
        write_folder(images, tmp_path / name, dict(zip((one.name for one in images), sides, strict=True)))
        return str(tmp_path / name)

    return make


def names(labelled: LabelledSet) -> list[str]:
    return [entry.name for entry in labelled.entries]


def test_of_a_folder_with_sides_the_train_side_is_used_and_that_is_said(folder, capsys):
    mine = folder("mine", "train", "test", "test")
    assert names(open_training_data([mine])) == ["clip-0"]
    assert "mine: 1 of 3 images are used, the side train" in capsys.readouterr().err
    assert (
        names(open_training_data([mine], "Test")) == names(open_training_data([mine], "test")) == ["clip-1", "clip-2"]
    )
    assert "mine: 2 of 3 images are used, the side test" in capsys.readouterr().err


def test_data_without_sides_is_used_whole_beside_a_side_of_other_data(folder):
    rendered, mine = folder("rendered", "", ""), folder("mine", "train", "test")
    for side in (None, "train"):
        found = open_training_data([rendered, mine], side)
        assert names(found) == ["rendered/clip-0", "rendered/clip-1", "mine train/clip-0"]


def test_experiments_learn_from_the_side_train_of_synthetic_images(folder, tmp_path, monkeypatch):
    pytest.importorskip("torch")
    from oysterbench_baselines.sim2real import experiment
    from oysterbench_baselines.sim2real.command import command

    seen: dict[str, LabelledSet] = {}
    monkeypatch.setattr(experiment, "run", lambda real, sources, *rest, **more: seen.update(sources))
    real, made = folder("real", "train", "test"), folder("made", "train", "test")
    words = ["--real", real, "--synthetic", f"made={made}", "--out", str(tmp_path / "out")]
    command.main(words, standalone_mode=False)
    assert names(seen["made"]) == ["clip-0"]


def test_nothing_is_said_where_nothing_is_left_out(folder, capsys):
    for sides in (("", ""), ("train", "train")):
        found = open_training_data([folder("mine", *sides)])
        assert (len(found), found.name) == (2, "mine")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("side", [None, "train"])
def test_of_annotations_with_a_side_on_some_images_only_those_are_used(tmp_path, capsys, side):
    images = [{"id": k, "file_name": f"a{k}.png", "width": 30, "height": 20} for k in range(4)]
    for one in images:
        write_png(tmp_path / one["file_name"], np.zeros((20, 30, 3), np.uint8))
    images[1]["split"] = "train"
    content = {"images": images, "annotations": [], "categories": [{"id": 1, "name": "oyster"}]}
    (tmp_path / "all.json").write_text(json.dumps(content))
    assert names(open_training_data([str(tmp_path)], side)) == ["a1"]
    assert "1 of 4 images are used, the side train" in capsys.readouterr().err


def test_a_side_that_is_nowhere_is_refused_and_that_none_is_for_training_is_said(folder, capsys):
    whole, sided = folder("whole", "", ""), folder("sided", "test", "val")
    with pytest.raises(LabelError, match="whole: no image of split 'train'"):
        open_training_data([whole], "train")
    with pytest.raises(LabelError, match="sided: no image of split 'train'; its splits: test, val"):
        open_training_data([whole, sided], "train")
    assert names(open_training_data([sided])) == ["clip-1"], "what is scored is not learnt from"
    said = "sided: 1 of 2 images are used, all but the side test: there is no side train, but test, val"
    assert said in capsys.readouterr().err
    for name, sides in (("tests", ("test", "test")), ("parts", ("val", "other"))):
        assert len(open_training_data([folder(name, *sides)])) == 2
        said = f"{name}: all images are used: there is no side train, but {', '.join(dict.fromkeys(sides))}"
        assert said in capsys.readouterr().err
