"""What a training leaves of the files that are there before it."""

from __future__ import annotations

import dataclasses
import json

import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from click.testing import CliRunner  # noqa: E402

from oysterbench.cli.main import main  # noqa: E402
from oysterbench.core.errors import MethodError  # noqa: E402
from oysterbench_baselines.learning.checkpoint import read_checkpoint  # noqa: E402
from oysterbench_baselines.learning.trained import run_training  # noqa: E402
from oysterbench_baselines.unet.training import train  # noqa: E402
from tests.helpers.small_trainings import SMALL, small_set  # noqa: E402

ONE = dataclasses.replace(SMALL, fit=dataclasses.replace(SMALL.fit, steps=1))


@pytest.fixture(scope="module")
def labelled(tmp_path_factory):
    """Two images to train on."""
    return small_set(tmp_path_factory.mktemp("trained") / "set", {"one": ("train", 2)})


def test_a_file_that_has_the_name_of_a_card_is_left_where_it_is_no_card(labelled, tmp_path):
    notes = json.dumps({"images": [], "annotations": []})
    (tmp_path / "mine.json").write_text(notes)
    for again in (False, True):
        run_training("unet_small", labelled, ONE, train, tmp_path / "mine.pt", 0, "cpu", again)
        assert (tmp_path / "mine.json").read_text() == notes


def test_a_device_that_is_not_there_costs_no_weights(labelled, tmp_path):
    (tmp_path / "mine.pt").write_bytes(b"an hour of training")
    with pytest.raises(MethodError, match="expected auto, cpu, cuda"):
        run_training("unet_small", labelled, ONE, train, tmp_path / "mine.pt", 0, "abacus", True)
    assert (tmp_path / "mine.pt").read_bytes() == b"an hour of training"


def test_weights_are_replaced_by_the_first_checkpoint_of_the_training_that_starts_over(labelled, tmp_path):
    path = tmp_path / "mine.pt"
    path.write_bytes(b"an hour of training")

    def stop(done, total):
        raise KeyboardInterrupt

    cpu = torch.device("cpu")
    with pytest.raises(KeyboardInterrupt):
        train(labelled, path, ONE, 0, cpu, stop, again=True)
    assert path.read_bytes() == b"an hour of training"
    assert train(labelled, path, ONE, 0, cpu, again=True).finished
    train(labelled, path, ONE, 1, cpu, again=True)
    assert read_checkpoint(path).identity["seed"] == 1


@pytest.mark.parametrize("command", ["steering", "gtsam_vi_learned"])
def test_data_that_cannot_be_read_costs_no_weights(tmp_path, command):
    (tmp_path / "data").mkdir()
    (tmp_path / "mine.pt").write_bytes(b"an hour of training")
    words = ["train", command, "--data", str(tmp_path / "data"), "--out", str(tmp_path / "mine.pt"), "--again"]
    assert CliRunner().invoke(main, words).exit_code != 0
    assert (tmp_path / "mine.pt").read_bytes() == b"an hour of training"
