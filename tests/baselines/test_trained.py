"""What a training leaves of the files that are there before it, and what takes weights that it has not finished."""

from __future__ import annotations

import dataclasses
import json

import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from click.testing import CliRunner  # noqa: E402

from oysterbench.cli.main import main  # noqa: E402
from oysterbench.core.errors import MethodError  # noqa: E402
from oysterbench.methods.weights import have_weights, weights_path  # noqa: E402
from oysterbench.notebook.doctor.data import look_at_data  # noqa: E402
from oysterbench_baselines.gtsam_vi_learned.model import MapModel  # noqa: E402
from oysterbench_baselines.learning.card import describe  # noqa: E402
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_checkpoint  # noqa: E402
from oysterbench_baselines.learning.trained import run_training  # noqa: E402
from oysterbench_baselines.moving.mask import MovingMask  # noqa: E402
from oysterbench_baselines.steering.model import SteeringModel  # noqa: E402
from oysterbench_baselines.unet.model import described, read_unet  # noqa: E402
from oysterbench_baselines.unet.training import begun_settings, identity, train  # noqa: E402
from tests.helpers.small_trainings import SMALL, small_set  # noqa: E402
from tests.helpers.weights_made import card_of, write_weights  # noqa: E402

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


def test_a_training_that_starts_over_replaces_weights_at_its_end_and_resumes_without_again(labelled, tmp_path):
    """And those of before, of the same training, are not taken for its own."""
    path, cpu = tmp_path / "mine.pt", torch.device("cpu")
    first = train(labelled, path, ONE, 0, cpu)
    first.seconds = -1.0
    first.write(path)
    before = path.read_bytes()

    def stop(done, total):
        raise KeyboardInterrupt

    for again in (True, False):
        with pytest.raises(KeyboardInterrupt):
            train(labelled, path, ONE, 0, cpu, stop, again=again)
        assert path.read_bytes() == before
    assert train(labelled, path, ONE, 0, cpu).seconds >= 0
    assert read_checkpoint(path).digest() == first.digest()
    assert [one.name for one in tmp_path.iterdir()] == ["mine.pt"]
    path.write_bytes(b"an hour of training")
    assert train(labelled, path, ONE, 1, cpu, again=True).finished
    assert read_checkpoint(path).identity["seed"] == 1


@pytest.mark.parametrize("command", ["steering", "gtsam_vi_learned"])
def test_data_that_cannot_be_read_costs_no_weights(tmp_path, command):
    (tmp_path / "data").mkdir()
    (tmp_path / "mine.pt").write_bytes(b"an hour of training")
    words = ["train", command, "--data", str(tmp_path / "data"), "--out", str(tmp_path / "mine.pt"), "--again"]
    assert CliRunner().invoke(main, words).exit_code != 0
    assert (tmp_path / "mine.pt").read_bytes() == b"an hour of training"


@pytest.mark.parametrize("finished", [False, True])
@pytest.mark.parametrize("read", [read_unet, SteeringModel.read, MapModel.read, MovingMask])
def test_weights_of_a_training_that_was_interrupted_are_refused(tmp_path, read, finished):
    """Also of one that had taken all steps, but had not measured its thresholds."""
    path = tmp_path / "half.pt"
    Checkpoint({"settings": {"measured": True}}, {}, {}, {}, {}, 30, finished, [1.0], 0.0).write(path)
    with pytest.raises(MethodError, match=r"half\.pt: the training is not finished, it has done 30 steps.*resumes"):
        read(path if read is not MovingMask else str(path))


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("unet", None, "the training is not finished, it has done 30 steps"),
        ("moving", None, "the training is not finished, it has done 30 steps"),
        ("unet", b"no file", "not a checkpoint of this version, or cut short"),
    ],
)
def test_weights_that_methods_refuse_are_refused_before_a_run_and_told_of(name, data, said, home, monkeypatch):
    monkeypatch.delenv(f"OYSTERBENCH_{name.upper()}", raising=False)
    path = weights_path(name)
    Checkpoint({}, {}, {}, {}, {}, 30, False, [1.0], 0.0).write(path)
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(MethodError, match=said):
        have_weights({name: path})
    doctor = {finding.name: finding for finding in look_at_data()}[f"weights {name}"]
    assert (doctor.state, said in doctor.detail) == ("broken", True)
    listed = json.loads(CliRunner().invoke(main, ["models", "--json"]).stdout)
    (row,) = (row for row in listed["models"] if row["model"] == name)
    assert row["here"].startswith("trained here (unfinished or damaged), ")


def test_a_damaged_file_beside_a_card_and_weights_of_another_kind_are_refused_before_a_run(labelled, home, monkeypatch):
    """A card tells only of the very file that it names."""
    for name in ("unet", "unet_small"):
        monkeypatch.delenv(f"OYSTERBENCH_{name.upper()}", raising=False)
    path = write_weights(weights_path("unet"))
    path.with_suffix(".json").write_bytes(card_of(path).data)
    have_weights({"unet": path})
    path.write_bytes(path.read_bytes()[:10_000])
    with pytest.raises(MethodError, match="not a checkpoint of this version"):
        have_weights({"unet": path})
    doctor = {finding.name: finding for finding in look_at_data()}["weights unet"]
    assert (doctor.state, doctor.advice) == ("broken", "oysterbench download unet --again")
    train(labelled, weights_path("unet_small"), ONE, 0, torch.device("cpu"))
    have_weights({"unet_small": weights_path("unet_small")})
    with pytest.raises(MethodError, match="expected weights of unet, got those of unet_small"):
        have_weights({"unet": weights_path("unet_small")})


def test_an_unfinished_training_that_its_command_takes_is_not_refused(home, monkeypatch):
    monkeypatch.delenv("OYSTERBENCH_CUT", raising=False)
    Checkpoint({}, {}, {}, {}, {}, 30, False, [1.0], 0.0).write(weights_path("cut"))
    have_weights({"cut": weights_path("cut")})


def test_no_training_begins_with_weights_of_one_that_was_interrupted(labelled, tmp_path):
    train(labelled, tmp_path / "half.pt", ONE, 0, torch.device("cpu"))
    dataclasses.replace(read_checkpoint(tmp_path / "half.pt"), finished=False).write(tmp_path / "half.pt")
    words = ["train", "unet_small", "--data", str(tmp_path), "--begin", str(tmp_path / "half.pt")]
    assert "the training is not finished" in " ".join(CliRunner().invoke(main, words).stderr.split())


def finished(settings, data, steps, begun=None):
    """A checkpoint as such a training leaves it, without weights."""
    known = identity(settings, data, 0, torch.device("cpu"), begun)
    network, measured = described(settings.network), {"calibration": {}}
    return Checkpoint(known, network, {}, {}, {}, steps, True, [1.0], 1.0, measured=measured)


@pytest.mark.parametrize("encoder", ["", "lite0"])
def test_the_card_of_weights_that_began_with_others_says_so_and_what_those_had_learnt_from(tmp_path, encoder):
    settings = dataclasses.replace(SMALL, network=dataclasses.replace(SMALL.network, encoder=encoder))
    name = "unet" if encoder else "unet_small"
    first = finished(settings, {"seg-train": "aa"}, 2000)
    second = finished(begun_settings(settings, first), {"mine": "bb"}, 200, first)
    third = finished(begun_settings(settings, second), {"mine": "cc"}, 100, second)
    third.write(tmp_path / "third.pt")
    card = describe(name, tmp_path / "third.pt")
    assert card.data == {"seg-train": "aa", "mine (earlier)": "bb", "mine": "cc"}
    begun = [f"weights of {name} after 200 steps on mine", f"weights of {name} after 2000 steps on seg-train"]
    begun += ["EfficientNet-lite0 trained on ImageNet"] if encoder else []
    assert card.begun.what == ", begun from ".join(begun)
    assert card.begun.source.startswith(f"oysterbench train {name}")
    assert ("Apache" in card.begun.licence) == bool(encoder)
