"""Trained weights that methods run on: which, fetched before a run where a hub is set, and known to results."""

from __future__ import annotations

import hashlib
from importlib.metadata import entry_points

import pytest

from oysterbench.core.errors import HubError, IntegrityError, MethodError, NetworkError
from oysterbench.hub.weights import weights_here
from oysterbench.methods import find_method
from oysterbench.methods.adapters import PythonMethod
from oysterbench.methods.weights import (
    Weights,
    existing,
    find_weights,
    have_weights,
    weights_names,
    weights_of,
    weights_path,
)
from tests.helpers.trees import a_key
from tests.helpers.weights_made import release, write_weights


@pytest.fixture
def bare(home, monkeypatch):
    """A home with nothing in it, and no hub."""
    for name in ("HUB", "HUB_KEY", "OFFLINE", "MODELS", "UNET"):
        monkeypatch.delenv(f"OYSTERBENCH_{name}", raising=False)
    return home


@pytest.fixture
def hub(bare, tmp_path, monkeypatch):
    """A hub that has `unet`, set as a user sets it. Gives the file that it has."""
    key, public = a_key(tmp_path)
    path = write_weights(tmp_path / "trained.pt")
    release(tmp_path / "tree", path, key)
    monkeypatch.setenv("OYSTERBENCH_HUB", str(tmp_path / "tree"))
    monkeypatch.setenv("OYSTERBENCH_HUB_KEY", public)
    return path


@pytest.mark.parametrize("name", weights_names())
def test_what_is_known_of_weights_is_of_commands_and_methods_that_there_are(name):
    known = find_weights(name)
    assert isinstance(known, Weights)
    assert known.name == name
    assert known.train.split()[0] in entry_points(group="oysterbench.train").names
    assert any(unit in known.takes for unit in ("minute", "hour"))
    for method in known.methods:
        assert name in weights_of(find_method(method)), method


def test_every_method_that_runs_on_weights_is_known_to_them():
    for point in entry_points(group="oysterbench.methods"):
        for name in weights_of(find_method(point.name)):
            assert point.name in find_weights(name).methods


def test_without_weights_and_hub_one_line_says_how_to_train_and_how_long_that_takes(bare):
    expected = (
        r"^unet: no trained weights at .*models/unet\.pt: `oysterbench train unet --data seg-train` trains them on "
        r"your machine \(about .* on .*\), `oysterbench download unet --from URL --key KEY` downloads them from a hub; "
        r"name others with unet\[checkpoint=PATH\] or OYSTERBENCH_UNET$"
    )
    for demand in (lambda path: have_weights({"unet": path}), lambda path: existing("unet", path)):
        with pytest.raises(MethodError, match=expected):
            demand(weights_path("unet"))
    with pytest.raises(MethodError, match=r"^mine: no trained weights at .*models/mine\.pt$"):
        have_weights({"mine": weights_path("mine")})


def test_absent_weights_are_fetched_from_the_hub_that_is_set(hub, bare):
    said = []
    have_weights({"unet": weights_path("unet")}, said.append)
    digest = hashlib.sha256(hub.read_bytes()).hexdigest()
    assert said == [
        f"unet: no trained weights here; downloading unet 1.0 from {hub.parent / 'tree'}, 0.1 MB, SHA-256 {digest}"
    ]
    assert (bare / "models" / "unet.pt").read_bytes() == hub.read_bytes()
    assert weights_here(weights_path("unet")).brief == "1.0"


def test_weights_that_are_here_are_taken_as_they_are(hub, bare):
    """Whether a hub has others, or could not be reached."""
    checkpoint = pytest.importorskip("oysterbench_baselines.learning.checkpoint", reason="PyTorch is not installed")
    checkpoint.Checkpoint({}, {}, {}, {}, {}, 1, True, [1.0], 0.0).write(weights_path("unet"))
    mine, said = weights_path("unet").read_bytes(), []
    have_weights({"unet": weights_path("unet")}, said.append)
    assert weights_path("unet").read_bytes() == mine
    assert said == []


def test_a_file_that_the_user_names_is_never_fetched(hub, tmp_path):
    with pytest.raises(MethodError, match=r"no trained weights at .*mine\.pt"):
        have_weights({"unet": tmp_path / "mine.pt"})
    assert not (tmp_path / "mine.pt").exists()


def test_where_the_hub_does_not_give_them_the_same_line_says_why(hub, bare, tmp_path, monkeypatch):
    with pytest.raises(HubError, match=r"moving: no trained weights at .*; from the hub: .*no split or model 'moving'"):
        have_weights({"moving": weights_path("moving")})
    monkeypatch.setenv("OYSTERBENCH_HUB_KEY", "ab" * 32)
    with pytest.raises(IntegrityError, match=r"unet: no trained weights .*; from the hub: .*not signed with the key"):
        have_weights({"unet": weights_path("unet")})
    monkeypatch.setenv("OYSTERBENCH_HUB", "http://127.0.0.1:9")
    monkeypatch.setenv("OYSTERBENCH_OFFLINE", "1")
    with pytest.raises(NetworkError, match=r"unet: no trained weights .*; from the hub: .*OYSTERBENCH_OFFLINE is set"):
        have_weights({"unet": weights_path("unet")})
    assert not list((bare / "models").glob("*.pt"))


LEARNT = """
from pathlib import Path

class Learnt:
    name, track = "learnt", "segmentation"

    def __init__(self, checkpoint: str = "", size: int = 3) -> None:
        self.checkpoint, self.size = checkpoint, size

    @property
    def weights(self):
        return {"learnt": Path(self.checkpoint or "absent.pt")}

    def run(self, images):
        return iter(())

class Plain:
    name, track = "plain", "segmentation"

    def __init__(self, table: str = "") -> None:
        self.table = table

    def run(self, images):
        return iter(())
"""


def test_results_and_runs_are_known_by_the_weights_content_and_not_their_place(tmp_path, monkeypatch):
    (tmp_path / "own_learnt.py").write_text(LEARNT)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    one, same, other = (write_weights(tmp_path / f"{name}.pt", seed) for name, seed in (("a", 1), ("b", 1), ("c", 2)))

    def adapter(path):
        return PythonMethod(f"own_learnt:Learnt[checkpoint={path},size=4]", ["segmentation"])

    digest = hashlib.sha256(one.read_bytes()).hexdigest()
    assert adapter(one).settings == adapter(same).settings == {"size": 4, "weights": {"learnt": digest}}
    assert adapter(other).settings != adapter(one).settings
    before = adapter(one)
    code = hashlib.sha256(LEARNT.encode()).hexdigest()
    assert before.identity["files"] == {"own_learnt.py": code, "weights of learnt": digest}
    one.write_bytes(other.read_bytes())
    assert before.identity["files"]["weights of learnt"] == hashlib.sha256(other.read_bytes()).hexdigest()
    given = PythonMethod(f"own_learnt:Learnt[checkpoint={other},size=4]", ["segmentation"])
    assert set(given.identity["files"]) == {"own_learnt.py", "weights of learnt"}
    plain = PythonMethod(f"own_learnt:Plain[table={other}]", ["segmentation"])
    assert plain.identity["files"]["file of table"] == hashlib.sha256(other.read_bytes()).hexdigest()
    assert PythonMethod("own_learnt:Learnt", ["segmentation"]).settings == {"weights": {"learnt": ""}}
