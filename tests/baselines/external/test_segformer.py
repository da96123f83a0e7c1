"""SegFormer: how it is launched, and, where it is built, that it learns and leaves what the tracks read."""

from __future__ import annotations

import json
import subprocess

import cv2
import numpy as np
import pytest

from oysterbench.core.helpers import module_command
from oysterbench.methods.options import with_options
from oysterbench.methods.systems import find_system, split_reference
from oysterbench.methods.systems.building import built, environment, interpreter
from oysterbench.methods.systems.launch import launch_of
from oysterbench.results.records import read_results
from tests.helpers.command import run, start
from tests.helpers.small_trainings import small_set

needs_build = pytest.mark.skipif(
    built(find_system("segformer")) is None, reason="SegFormer is not built here: oysterbench systems build segformer"
)


@pytest.mark.parametrize(("method", "instances"), [("segformer", False), ("segformer_instances", True)])
def test_its_program_is_given_the_pictures_and_the_options_without_the_path_of_the_weights(method, instances, tmp_path):
    weights = tmp_path / "mine.pt"
    weights.write_bytes(b"weights")
    place = find_system("segformer").place
    _, words = launch_of(f"{method}[weights={weights},flips=true]", place, tmp_path / "given", tmp_path, 0)
    task = tmp_path / "configuration" / "task.json"
    given = (task, weights, tmp_path / "given", tmp_path / "predictions")
    python = place / "venv" / "bin" / "python"
    assert words == module_command("oysterbench_baselines.external.segformer.segment", *given, python=python)
    read = json.loads(task.read_text())
    assert read == {"device": "auto", "flips": True, "least_area": 30, "instances": instances}
    assert split_reference(f"{method}[weights={weights}]")[2]["weights"] == str(weights)


def test_without_a_build_its_training_says_what_to_type(home):
    done = run("train", "segformer", "--data", "seg-mini")
    assert done.returncode == 1
    assert done.stderr == "oysterbench: segformer is not built here; type: oysterbench systems build segformer\n"


@needs_build
def test_it_is_trained_in_the_environment_of_its_build_which_shares_torch(tmp_path):
    """A few steps on small pictures: enough to go on, to be read, and to be run on both tracks."""
    system = find_system("segformer")
    small_set(tmp_path / "set", {"one": ("train", 20), "two": ("test", 2)})
    weights = tmp_path / "small.pt"
    words = ["train", "segformer", "--data", tmp_path / "set", "--side", "train", "--out", weights, "--threads", "1"]
    trained = start(*words, "--steps", "3", "--device", "cpu")
    assert trained.returncode == 0, trained.stderr
    assert trained.stdout.strip() == str(weights)
    assert "training segformer on 20 images: 3 of 3 steps" in trained.stderr
    assert "thresholds were measured on 2 images held out" in trained.stderr
    assert not list(environment(system).glob("lib/python*/site-packages/torch"))

    for method, track in (("segformer", "segmentation"), ("segformer_instances[least_area=1]", "detection")):
        done = start(
            "run", with_options(method, [f"weights={weights}"]), "--on", tmp_path / "set", "--out", tmp_path / track
        )
        assert done.returncode == 0, done.stderr
        records = read_results(tmp_path / track / "results.json")
        assert {record.sequence for record in records} == {"two"}  # of data that has sides, the test side
        assert {record.track for record in records} == {track}
        assert all(record.failure is None for record in records)
        assert all(record.info["run"]["versions"]["transformers"] == "5.23.0" for record in records)


LEARNS = """
import dataclasses, sys
from pathlib import Path
import numpy as np, torch
from oysterbench.annotations import open_labelled
from oysterbench_baselines.external.segformer.network import MULTIPLE, SegFormer, SegFormerSettings, read_model
from oysterbench_baselines.external.segformer.training import TrainingSettings, train
from oysterbench_baselines.learning.augment import Augmentation
from oysterbench_baselines.unet.calibration import Calibration

small = TrainingSettings(batch=4, network=SegFormerSettings(scale=1.0), augmentation=Augmentation(crop=64))
settings = dataclasses.replace(small, fit=dataclasses.replace(small.fit, steps=60, warm_up=5, threads=1))
labelled, path = open_labelled(sys.argv[1]), Path(sys.argv[2])
train(labelled, path, settings, 0, torch.device("cpu"))
model, calibration = read_model(path, torch.device("cpu"))
assert calibration == Calibration()  # 4 images of one clip: none was held out
np.savez(sys.argv[3], **{one.name: model.logits(one.pixels)[0] > 0 for one in labelled})
assert model.logits(np.zeros((61, 83, 3), np.uint8)).shape == (2, 61, 83)
"""


CALIBRATED = """
import sys
from pathlib import Path
import numpy as np, torch
from oysterbench_baselines.external.segformer.segment import division, predictions
from oysterbench_baselines.learning.masks import MaskModel
from oysterbench_baselines.unet.calibration import Calibration

class Flat(torch.nn.Module):
    def forward(self, pixels):
        return torch.ones(1, 2, *pixels.shape[-2:])

model = MaskModel(Flat(), 0.5, 32, torch.device("cpu"))
for cut, above in ((0.0, True), (1.5, False)):
    calibration = Calibration(cut=cut, temperature=2.0, rise=0.07, sure=0.3)
    ((name, oyster, depth),) = predictions(model, calibration, Path(sys.argv[1]), flips=True)
    assert name == "one" and oyster.shape == depth.shape == (48, 64)
    assert np.allclose(oyster, 1 / (1 + np.exp(-(1 - cut) / 2))) and (oyster > 0.5).all() == above
    assert np.allclose(depth, 1 / (1 + np.exp(-1)))  # as the network has it
    found = division(oyster, calibration, 30.0)
    assert (found.rise, found.sure) == (0.07, 0.3) and found.area == 30.0 * (320 / 64) ** 2
"""


@needs_build
def test_its_thresholds_are_those_that_were_measured(tmp_path):
    (tmp_path / "images.txt").write_text("one\n")
    assert cv2.imwrite(str(tmp_path / "one.png"), np.full((48, 64, 3), 90, np.uint8))
    words = [interpreter(find_system("segformer")), "-c", CALIBRATED, tmp_path]
    done = subprocess.run([*map(str, words)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@needs_build
def test_it_learns_what_it_is_shown(tmp_path):
    labelled = small_set(tmp_path / "set", {"one": ("train", 4)})
    words = [
        interpreter(find_system("segformer")),
        "-c",
        LEARNS,
        tmp_path / "set",
        tmp_path / "a.pt",
        tmp_path / "a.npz",
    ]
    done = subprocess.run([*map(str, words)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = np.load(tmp_path / "a.npz")
    both = sum((found[one.name] & one.oysters).sum() for one in labelled)
    either = sum((found[one.name] | one.oysters).sum() for one in labelled)
    assert both / either > 0.5
