"""Trained weights that are part of oysterbench, as their users meet them, beside those of a hub and their own."""

from __future__ import annotations

import hashlib
import json
import shutil

import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'oysterbench[learn]'")

from oysterbench_baselines.unet.training import train  # noqa: E402
from tests.helpers.small_trainings import SMALL  # noqa: E402
from tests.helpers.trees import oysterbench_serve  # noqa: E402
from tests.helpers.web import misbehaving  # noqa: E402
from tests.helpers.weights_place import Place  # noqa: E402


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return Place(tmp_path_factory.mktemp("models"))


@pytest.fixture(scope="module")
def published(place):
    """Two versions on the hub."""
    place.publish("--version", "0.9")
    place.publish()


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
    empty, lost, barred = (tmp_path / name for name in ("empty", "lost", "barred"))
    key = ("--key", place.public)
    empty.mkdir()
    (lost / "blobs").mkdir(parents=True)
    (barred / "index.json").mkdir(parents=True)
    shutil.copytree(place.tree, tmp_path / "cardless")
    for card in (tmp_path / "cardless" / "models").glob("*.json"):
        card.unlink()
        card.mkdir()
    given = [
        (1, "its public key is not known here", place.tree),
        (1, "expected a hub's public key, 64 hex digits", place.tree, "--key", "abc"),
        (1, "no such folder", tmp_path / "none", *key),
        (1, "this folder holds no published tree", empty, *key),
        (4, "index.json is not there", lost, *key),
        (4, "barred/index.json: Is a directory", barred, *key),
        (4, "the card of unet_small 1.0 could not be fetched", tmp_path / "cardless", *key),
    ]
    with oysterbench_serve(place.tree) as url, misbehaving("unavailable", {"index.json": b"{}"}, 1, 1.0) as broken:
        given.append((4, f"{broken.url}: status ", broken.url, *key))
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
