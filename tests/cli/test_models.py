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
from tests.helpers.small_trainings import SMALL, small_set  # noqa: E402
from tests.helpers.trees import oysterbench_serve, tree_bytes  # noqa: E402
from tests.helpers.weights_made import write_weights  # noqa: E402


class Place:
    """A user with a training of a unet, who has a hub; and commands, run as in a shell with nothing set."""

    def __init__(self, folder):
        self.folder, self.home, self.tree = folder, folder / "home", folder / "hub"
        self.weights = self.home / "models" / "unet_small.pt"
        self.learnt = small_set(folder / "shells", {"one": ("train", 4)})
        self.unseen = small_set(folder / "unseen", {"two": ("val", 2)}, first=50)
        train(self.learnt, self.weights, SMALL, 3, torch.device("cpu"))
        self.digest = hashlib.sha256(self.weights.read_bytes()).hexdigest()
        self.public = self.run("keygen", folder / "key.pem").stdout.strip()

    def run(self, *arguments, code=0, home=None, **environment):
        clean = {key: None for key in os.environ if key.startswith("OYSTERBENCH")}
        done = CliRunner().invoke(
            main,
            [str(argument) for argument in arguments],
            env=clean | {"OYSTERBENCH_HOME": str(home or self.home)} | environment,
        )
        assert done.exit_code == code, done.stderr
        return done

    def publish(self, *arguments, tree=None, **options):
        words = ("publish-model", "unet_small", tree or self.tree, "--key", self.folder / "key.pem")
        return self.run(*words, *arguments, **options)


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
    from click.testing import CliRunner

    from oysterbench.cli.main import main

    monkeypatch.delenv("OYSTERBENCH_HUB", raising=False)
    said = " ".join(CliRunner().invoke(main, ["download", "unett"]).stderr.split())
    assert "did you mean unet" in said
    assert "`oysterbench models` list what there is" in said


@pytest.fixture
def part(place, tmp_path, monkeypatch):
    """The weights as part of oysterbench, and a user who has none of his own: their file, and his home."""
    folder = tmp_path / "package" / "models"
    for module in ("methods.weights", "hub.weights"):
        monkeypatch.setattr(f"oysterbench.{module}.released_models", lambda: folder)
    words = ("release-model", "unet_small", "--weights", place.weights, "--version", "1.0", "--out", folder)
    assert place.run(*words).stdout == f"{folder / 'unet_small.pt'}\n"
    return folder / "unet_small.pt", tmp_path / "home"


def test_methods_run_on_weights_that_are_part_of_oysterbench(place, part, tmp_path):
    path, home = part
    assert path.read_bytes() == place.weights.read_bytes()
    words = ("segment", place.folder / "unseen" / "images", "--method", "unet_small_instances")
    done = place.run(*words, "--out", tmp_path / "out", home=home)
    assert "no trained weights" not in done.stderr
    assert (tmp_path / "out" / "index.html").is_file()
    (row,) = [
        row
        for row in json.loads(place.run("models", "--json", home=home).stdout)["models"]
        if row["model"] == "unet_small"
    ]
    assert row["here"].startswith("1.0, part of oysterbench, ")
    assert row["file"] == str(path)
    assert place.run("models", "unet_small", home=home).stdout.startswith("unet_small 1.0\n")
    told = place.run("download", "unet_small", home=home)
    assert told.stdout == f"{path}\n"
    assert "unet_small 1.0 (" in told.stderr
    assert "part of oysterbench" in told.stderr
    assert not (home / "models").exists()
    hub = {"OYSTERBENCH_HUB": "https://127.0.0.1:9", "OYSTERBENCH_OFFLINE": "1"}
    assert place.run("download", "unet_small", home=home, **hub).stdout == f"{path}\n"


def test_a_hub_that_is_named_is_asked_for_the_version_that_oysterbench_has_too(place, published, part, tmp_path):
    """It may be another lab's, whose weights of that number are others."""
    _, home = part
    hub = ("--from", place.tree, "--key", place.public)
    own = home / "models" / "unet_small.pt"
    assert place.run("download", "unet_small@1.0", *hub, home=home).stdout == f"{own}\n"
    assert own.is_file()


def test_where_a_hub_lacks_them_or_does_not_answer_weights_of_oysterbench_are_named(place, part, tmp_path):
    (path, home), key, tree = part, tmp_path / "other.pem", tmp_path / "tree"
    public = place.run("keygen", key).stdout.strip()
    words = ("publish-model", "unet_small", tree, "--key", key, "--version", "2.0", "--weights", place.weights)
    place.run(*words)
    lacks = "the hub has no version '1.0' of unet_small; it has 2.0; "
    for hub, why in ((tree, lacks), ("http://127.0.0.1:9", "http://127.0.0.1:9: no answer")):
        told = place.run("download", "unet_small@1.0", "--from", hub, "--key", public, home=home)
        assert told.stdout == f"{path}\n"
        assert why in told.stderr
        assert "is part of oysterbench" in told.stderr


def test_weights_of_oysterbench_are_not_named_in_place_of_a_hub_that_is_given_wrongly(place, published, part, tmp_path):
    """A script that fetches newer ones would go on with those."""
    empty, lost, key = tmp_path / "empty", tmp_path / "lost", ("--key", place.public)
    empty.mkdir()
    (lost / "blobs").mkdir(parents=True)
    given = [
        (1, "its public key is not known here", place.tree),
        (1, "expected a hub's public key, 64 hex digits", place.tree, "--key", "abc"),
        (1, "no such folder", tmp_path / "none", *key),
        (1, "this folder holds no published tree", empty, *key),
        (4, "index.json is not there", lost, *key),
    ]
    with oysterbench_serve(place.tree) as url:
        given.append((4, "status 404", f"{url}/elsewhere", *key))
        for code, why, *words in given:
            told = place.run("download", "unet_small", "--from", *words, code=code, home=part[1])
            assert why in " ".join(told.stderr.split())
            assert told.stdout == ""


def test_models_and_publishing_take_the_weights_that_a_variable_names(place, part, tmp_path):
    """As methods do, and not those of the package under their old card."""
    own = tmp_path / "own.pt"
    train(place.learnt, own, SMALL, 7, torch.device("cpu"))
    named = {"home": part[1], "OYSTERBENCH_UNET_SMALL": str(own)}
    digest = hashlib.sha256(own.read_bytes()).hexdigest()
    assert json.loads(place.run("models", "unet_small", "--json", **named).stdout)["file"]["sha256"] == digest
    rows = json.loads(place.run("models", "--json", **named).stdout)["models"]
    assert [row["file"] for row in rows if row["model"] == "unet_small"] == [str(own)]
    words = ("publish-model", "unet_small", tmp_path / "tree", "--key", place.folder / "key.pem", "--json")
    assert json.loads(place.run(*words, **named).stdout)["file"]["sha256"] == digest


def test_weights_trained_or_downloaded_here_go_before_those_of_oysterbench(place, published, part, tmp_path):
    _, home = part
    hub = ("--from", place.tree, "--key", place.public)
    own = home / "models" / "unet_small.pt"
    assert place.run("download", "unet_small@0.9", *hub, home=home).stdout == f"{own}\n"
    row = next(
        row
        for row in json.loads(place.run("models", "--json", home=home).stdout)["models"]
        if row["model"] == "unet_small"
    )
    assert (row["file"], row["here"].split(",")[0]) == (str(own), "0.9")
    absent = place.run("download", "unet_small@7", home=home, code=1)
    assert "no hub is set" in absent.stderr


def test_a_release_of_weights_never_changes_and_keeps_its_card(place, part, tmp_path):
    path, home = part
    card = path.with_suffix(".json").read_bytes()
    words = ("release-model", "unet_small", "--weights", place.weights, "--out", path.parent)
    failed = place.run(*words, "--summary", "Others", code=1)
    assert "a release never changes" in failed.stderr
    assert path.with_suffix(".json").read_bytes() == card
    place.run(*words)  # the same again
    tree = tmp_path / "tree"
    place.run("keygen", tmp_path / "key.pem")
    words = ("publish-model", "unet_small", tree, "--key", tmp_path / "key.pem")
    place.run(*words, home=home)
    assert [one.read_bytes() for one in (tree / "models").iterdir()] == [card]
    place.run(*words, "--version", "1.1", home=home)
    assert len(list((tree / "models").iterdir())) == 2
    place.run("release-model", "unet_small", "--weights", place.weights, "--out", path.parent, "--version", "1.1")
    assert json.loads(path.with_suffix(".json").read_text())["version"] == "1.1"


def test_weights_of_another_kind_are_refused_though_their_own_card_is_beside_them(place, part, tmp_path):
    """Before anything is run, shown or published under the name of others."""
    path, home = part
    named = {"home": home, "OYSTERBENCH_STEERING": str(path), "OYSTERBENCH_UNET": str(path)}
    said = f"{path}: expected weights of unet, got unet_small 1.0, as the card beside them says"
    publish = ("publish-model", "unet", tmp_path / "tree", "--key", place.folder / "key.pem")
    for words in (
        ("models", "unet"),
        ("run", "unet", "--on", place.folder / "unseen", "--out", tmp_path / "out"),
        ("run", f"unet[checkpoint={path}]", "--on", place.folder / "unseen", "--out", tmp_path / "out"),
        publish,
        (*publish, "--weights", path, "--version", "2.0"),
        ("release-model", "unet", "--weights", path, "--out", tmp_path / "out"),
    ):
        assert said in place.run(*words, code=1, **named).stderr
    assert not (tmp_path / "tree").exists()
    assert not list((tmp_path / "out").rglob("*.*"))
    assert place.run("download", "unet", code=1, **named).stdout == ""
    findings = json.loads(place.run("doctor", "--json", code=1, **named).stdout)["findings"]
    assert [one["state"] for one in findings if one["name"] == "weights steering"] == ["broken"]
    rows = json.loads(place.run("models", "--json", **named).stdout)["models"]
    (row,) = (row for row in rows if row["model"] == "steering")
    assert "1.0, part of oysterbench (of another kind)" in row["here"]
