"""Trained weights as their users meet them: published from a training, served, fetched by a run, and told of."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
import shutil

import pytest
from click.testing import CliRunner

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from oysterbench.cli.main import main  # noqa: E402
from oysterbench.results.records import read_results, write_results  # noqa: E402
from oysterbench_baselines.learning.card import describe  # noqa: E402
from oysterbench_baselines.learning.checkpoint import read_checkpoint  # noqa: E402
from oysterbench_baselines.unet.training import train  # noqa: E402
from tests.helpers.small_trainings import SMALL  # noqa: E402
from tests.helpers.trees import oysterbench_serve, tree_bytes  # noqa: E402
from tests.helpers.weights_made import write_weights  # noqa: E402
from tests.helpers.weights_place import Place  # noqa: E402


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return Place(tmp_path_factory.mktemp("models"))


@pytest.fixture(scope="module")
def fetched(place):
    """A bare machine that runs the method, with a hub that has the weights: its home, the folder, what was said."""
    place.publish("--version", "0.9")
    home, folder = place.folder / "bare", place.folder / "val"
    with oysterbench_serve(place.tree) as url:
        hub = {"OYSTERBENCH_HUB": url, "OYSTERBENCH_HUB_KEY": place.public}
        done = place.run("run", "unet_small", "--on", place.folder / "unseen", "--out", folder, home=home, **hub)
    return home, folder, url, done.stderr.splitlines()


@pytest.fixture(scope="module")
def results(fetched):
    """What the run left."""
    return fetched[1]


@pytest.fixture(scope="module")
def published(place, results):
    """The card, as `publish-model` prints it."""
    return json.loads(place.publish("--results", results, "--json").stdout)


def test_the_card_says_what_was_learnt_from_how_and_what_was_reached(place, published, results):
    training = published["training"]
    assert training["data"] == {"shells": place.learnt.digest()}
    assert (training["steps"], training["seed"], training["device"]) == (SMALL.fit.steps, 3, "cpu")
    assert training["settings"]["fit"]["learning_rate"] == SMALL.fit.learning_rate
    assert training["versions"]["torch"] == torch.__version__
    network = read_checkpoint(place.weights)
    assert training["parameters"] == sum(part.numel() for part in network.weights.values())
    assert (published["file"]["sha256"], published["methods"]) == (place.digest, ["unet_small", "unet_small_instances"])
    (record,) = read_results(results / "results.json")
    figures = {figure["metric"]: figure for figure in published["figures"]}
    assert figures["iou"]["value"] == record.metrics["iou"]
    assert {figure["results"] for figure in published["figures"]} == {
        hashlib.sha256((results / "results.json").read_bytes()).hexdigest()
    }


def test_a_run_on_a_bare_machine_fetches_the_weights_and_its_results_know_them(place, fetched):
    home, folder, url, lines = fetched
    said = (
        rf"unet_small: no trained weights here; downloading unet_small 0\.9 from {url}, .* MB, SHA-256 {place.digest}"
    )
    assert any(re.fullmatch(said, line) for line in lines)
    assert (home / "models" / "unet_small.pt").read_bytes() == place.weights.read_bytes()
    (record,) = read_results(folder / "results.json")
    assert record.method_settings == {"weights": {"unet_small": place.digest}}
    assert record.metrics["iou"] > 0


def test_what_was_run_with_other_weights_is_not_taken_for_theirs(place, results, tmp_path):
    shutil.copytree(results, tmp_path / "val")
    train(place.learnt, tmp_path / "models" / "unet_small.pt", SMALL, 5, torch.device("cpu"))
    words = ("run", "unet_small", "--on", place.folder / "unseen", "--out", tmp_path / "val")
    failed = place.run(*words, home=tmp_path, code=1)
    assert "weights of unet_small changed" in failed.stderr
    assert "rerun it with --again" in failed.stderr


def test_counting_in_pictures_of_ones_own_fetches_them_too(place, published, tmp_path):
    hub = {"OYSTERBENCH_HUB": str(place.tree), "OYSTERBENCH_HUB_KEY": place.public}
    words = ("segment", place.folder / "unseen" / "images", "--method", "unet_small_instances")
    done = place.run(*words, "--out", tmp_path / "out", home=tmp_path, **hub)
    assert "unet_small: no trained weights here; downloading unet_small 1.0 from" in done.stderr
    assert (tmp_path / "models" / "unet_small.pt").read_bytes() == place.weights.read_bytes()
    assert (tmp_path / "out" / "index.html").is_file()


def test_download_leaves_weights_where_methods_look_for_them(place, published, tmp_path):
    hub = ("--from", place.tree, "--key", place.public)
    path = tmp_path / "models" / "unet_small.pt"
    plan = json.loads(place.run("download", "unet_small", *hub, "--dry-run", "--json", home=tmp_path).stdout)
    assert (plan["state"], plan["file"], plan["sha256"]) == ("to fetch", str(path), place.digest)
    assert not path.exists()
    done = place.run("download", "unet_small@1.0", *hub, home=tmp_path)
    assert done.stdout == f"{path}\n"
    assert path.read_bytes() == place.weights.read_bytes()
    assert read_checkpoint(path).finished
    assert "here, " in place.run("download", "unet_small", *hub, "--dry-run", home=tmp_path).stdout
    assert f"{path}: right" in place.run("verify", home=tmp_path).stdout
    offline = {"OYSTERBENCH_HUB": "http://127.0.0.1:9", "OYSTERBENCH_OFFLINE": "1"}
    for name in ("unet_small", "unet_small@1.0"):  # what is here needs no network
        assert place.run("download", name, home=tmp_path, **offline).stdout == f"{path}\n"
    absent = place.run("download", "unet_small@2", home=tmp_path, code=4, **offline)
    assert "OYSTERBENCH_OFFLINE is set" in absent.stderr
    assert "found here: unet_small 1.0 of a hub" in place.run("download", "unet_small", home=tmp_path, code=1).stderr
    done = place.run("download", "unet_small", *hub, "--out", tmp_path / "out", "--json", home=tmp_path)
    assert json.loads(done.stdout)["file"] == str(tmp_path / "out" / "unet_small.pt")
    assert (tmp_path / "out" / "unet_small.pt").read_bytes() == path.read_bytes()


def test_a_training_of_ones_own_is_not_replaced_unasked(place, published, tmp_path):
    hub, path = ("--from", place.tree, "--key", place.public), tmp_path / "models" / "unet_small.pt"
    mine = write_weights(path, 5).read_bytes()
    for words in ((), ("--dry-run",)):
        failed = place.run("download", "unet_small", *hub, *words, home=tmp_path, code=1)
        assert re.search(r"there are weights trained here \(.*\); .* --again replaces them", failed.stderr)
        assert path.read_bytes() == mine
    place.run("download", "unet_small", *hub, "--again", home=tmp_path)
    assert path.read_bytes() == place.weights.read_bytes()


def test_a_training_that_begins_anew_takes_the_card_of_what_was_fetched_away(place, published, tmp_path):
    path = tmp_path / "models" / "unet_small.pt"
    place.run("download", "unet_small", "--from", place.tree, "--key", place.public, home=tmp_path)
    assert path.with_suffix(".json").is_file()
    words = ("train", "unet_small", "--data", place.folder / "shells", "--steps", "1", "--threads", "1")
    assert "remove it to train anew" in place.run(*words, home=tmp_path, code=1).stderr
    place.run(*words, "--again", home=tmp_path)
    assert not path.with_suffix(".json").exists()
    assert "trained here" in place.run("models", home=tmp_path).stdout


def test_models_tells_what_is_here_what_the_hub_has_and_what_training_takes(place, published, tmp_path):
    rows = json.loads(place.run("models", "--json", home=tmp_path).stdout)["models"]
    assert {"unet_small", "moving", "steering", "gtsam_vi_learned", "cut"} <= {row["model"] for row in rows}
    released = {"unet", "steering"}
    assert all((row["here"] == "no") == (row["model"] not in released) and row["takes"] for row in rows)
    hub = ("--from", place.tree, "--key", place.public)
    rows = json.loads(place.run("models", "--json", *hub).stdout)["models"]
    (row,) = (row for row in rows if row["model"] == "unet_small")
    assert (row["here"][:12], row["sha256"]) == ("trained here", place.digest)
    assert [version[:3] for version in row["hub"]] == ["0.9", "1.0"]
    card = place.run("models", "unet_small", *hub, home=tmp_path).stdout
    assert "Trained on: shells (SHA-256" in card
    assert "unet_small on own data: IoU 0." in card
    assert "unet_small trained here" in place.run("models", "unet_small").stdout
    assert "gtsam_vi[mask=moving]" in place.run("models").stdout


def test_publishing_says_in_one_line_why_it_refuses(place, results, tmp_path):
    def line(*words, code=1, name="unet_small", **options):
        arguments = ("publish-model", name, tmp_path / "tree", "--key", place.folder / "key.pem", *words)
        done = place.run(*arguments, code=code, **options)
        assert done.stderr.count("\n") == 1, done.stderr
        assert not (tmp_path / "tree" / "index.json").exists()
        return done.stderr

    unfinished = read_checkpoint(place.weights)
    dataclasses.replace(unfinished, finished=False, step=5).write(tmp_path / "half.pt")
    assert "the training is not finished, it has done 5 steps" in line("--weights", tmp_path / "half.pt")
    assert "not a checkpoint of this version" in line("--weights", write_weights(tmp_path / "noise.pt"))
    assert "no such checkpoint" in line(home=tmp_path)
    assert "expected weights of moving, got those of unet_small" in line("--weights", place.weights, name="moving")
    assert "no trained weights are called 'unett'; it has cut" in line(name="unett")
    train(place.learnt, tmp_path / "other.pt", SMALL, 4, torch.device("cpu"))
    other = hashlib.sha256((tmp_path / "other.pt").read_bytes()).hexdigest()
    said = line("--weights", tmp_path / "other.pt", "--results", results)
    assert f"expected results of these weights of unet_small (SHA-256 {other[:12]}…)" in said
    assert f"got unet_small with {place.digest[:12]}…" in said
    (record,) = read_results(results / "results.json")
    write_results(tmp_path / "bad.json", [dataclasses.replace(record, failure="it fell over")])
    assert "unet_small failed on two: it fell over" in line("--results", tmp_path / "bad.json")
    write_results(tmp_path / "plain.json", [dataclasses.replace(record, method_settings={})])
    assert "none that says which weights" in line("--results", tmp_path / "plain.json")


def test_asking_for_weights_in_vain_is_one_line(place, published, tmp_path):
    def line(code, *words, **environment):
        done = place.run(*words, code=code, home=tmp_path, **environment)
        assert done.stdout == ""
        assert done.stderr.count("\n") == 1, done.stderr
        return done.stderr

    hub = ("--from", place.tree, "--key", place.public)
    said = line(1, "download", "unet_small")
    assert "`oysterbench train unet_small --data seg-train` trains them on your machine (about" in said
    assert "no split or model 'unett'; it has unet_small" in line(1, "download", "unett", *hub)
    assert "no split or model 'moving'; it has unet_small" in line(1, "download", "moving", *hub)
    assert "no version '9' of unet_small; it has 0.9, 1.0" in line(1, "download", "unet_small@9", *hub)
    assert "no split or model '../unet_small'" in line(1, "download", "../unet_small", *hub)
    assert "not signed with the key" in line(3, "download", "unet_small", "--from", place.tree, "--key", "ab" * 32)
    assert "its public key is not known here" in line(1, "download", "unet_small", "--from", place.tree)
    refused = place.run("download", "unet_small", *hub, "--topics", "/imu", code=2, home=tmp_path)
    assert "apply to splits" in refused.stderr
    assert "unet_small: no trained weights at" in line(1, "models", "unet_small")
    # A run says so before anything is run, and leaves no failed results behind.
    words = ("run", "unet_small", "--on", place.folder / "unseen", "--out", tmp_path / "val")
    assert "unet_small: no trained weights at" in line(1, *words)
    assert not (tmp_path / "val" / "results.json").exists()


def test_what_a_download_gives_runs_no_code_when_it_is_read(place, tmp_path):
    """Not even where the hub's owner had put some into the weights."""

    class Burglar:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "broken-into"),)

    torch.save({"format": "oysterbench-checkpoint/1", "identity": Burglar()}, tmp_path / "unet_small.pt")
    with pytest.raises(Exception, match="not a checkpoint of this version"):
        describe("unet_small", tmp_path / "unet_small.pt")
    assert not (tmp_path / "broken-into").exists()


def test_publishing_again_adds_nothing(place, published, results, tmp_path):
    shutil.copytree(place.tree, tmp_path / "tree")
    before = tree_bytes(tmp_path / "tree")
    place.publish("--results", results, tree=tmp_path / "tree")
    assert tree_bytes(tmp_path / "tree") == before
    without_figures = place.publish(tree=tmp_path / "tree", code=1)
    assert "another --version" in without_figures.stderr


def test_a_name_that_is_neither_split_nor_model_gets_the_nearest_ones(home, monkeypatch):

    monkeypatch.delenv("OYSTERBENCH_HUB", raising=False)
    said = " ".join(CliRunner().invoke(main, ["download", "unett"]).stderr.split())
    assert "did you mean unet" in said
    assert "`oysterbench models` list what there is" in said
