"""What the thresholds of trained weights were measured on, and what there is where nothing could be measured."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from click.testing import CliRunner  # noqa: E402

from oysterbench.cli.main import main  # noqa: E402
from oysterbench_baselines.learning.checkpoint import read_checkpoint  # noqa: E402
from oysterbench_baselines.unet.calibration import Calibration, measured  # noqa: E402
from oysterbench_baselines.unet.training import thresholds_of, train  # noqa: E402
from oysterbench_baselines.unet.views import Look  # noqa: E402
from tests.helpers.small_trainings import SMALL, small_set  # noqa: E402

ONE = dataclasses.replace(SMALL, fit=dataclasses.replace(SMALL.fit, steps=1))
CPU = torch.device("cpu")
KNOWN = Calibration(temperature=1.5, cut=0.4, rise=0.06, sure=0.3, live_cut=1.0, states=0.9, images=240)


@pytest.fixture
def begun(tmp_path):
    """Weights whose thresholds were measured on many images."""
    checkpoint = train(small_set(tmp_path / "many", {"one": ("", 2)}), tmp_path / "begun.pt", ONE, 0, CPU)
    checkpoint.measured["calibration"] = dataclasses.asdict(KNOWN)
    checkpoint.write(tmp_path / "begun.pt")
    return tmp_path / "begun.pt"


def test_a_training_on_few_images_keeps_the_thresholds_of_the_weights_that_it_began_with(tmp_path, begun):
    small_set(tmp_path / "few", {"one": ("", 9)})
    words = ["train", "unet_small", "--data", str(tmp_path / "few"), "--begin", str(begun), "--steps", "1"]
    done = CliRunner().invoke(main, [*words, "--out", str(tmp_path / "mine.pt"), "--device", "cpu", "--threads", "1"])
    assert done.exit_code == 0, done.stderr
    mine = read_checkpoint(tmp_path / "mine.pt")
    assert Calibration(**mine.measured["calibration"]) == KNOWN
    said = (
        "no oyster in images held out: thresholds are those of the weights that it began with, measured on 240 images"
    )
    assert said in " ".join(done.stderr.split())


def test_where_images_are_held_out_thresholds_are_measured_anew_and_on_how_many_is_said(tmp_path, begun):
    checkpoint = train(
        small_set(tmp_path / "more", {"one": ("", 20)}), tmp_path / "a.pt", ONE, 0, CPU, begun=read_checkpoint(begun)
    )
    assert checkpoint.measured["calibration"]["images"] == 2
    assert thresholds_of(checkpoint, read_checkpoint(begun)) == "thresholds were measured on 2 images held out"


def test_weights_with_default_thresholds_say_so(tmp_path):
    checkpoint = train(small_set(tmp_path / "few", {"one": ("", 4)}), tmp_path / "a.pt", ONE, 0, CPU)
    assert thresholds_of(checkpoint) == (
        "no oyster in images held out: thresholds are the default ones, and counts may be far off"
    )
    nothing = small_set(tmp_path / "more", {"one": ("", 2)}).where(lambda entry: False)
    assert measured(nothing, lambda pixels: Look(np.zeros((2, 4, 4), np.float32)), otherwise=KNOWN) == KNOWN
