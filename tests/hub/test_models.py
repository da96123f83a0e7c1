"""Trained weights in a hub: what is published, whom a download trusts, what it keeps, and what it never replaces."""

from __future__ import annotations

import json
import shutil

import msgspec
import pytest

from oysterbench.core.errors import HubError, IntegrityError, NetworkError
from oysterbench.hub.canonical import canonical, sha256
from oysterbench.hub.download import Hub, part_path
from oysterbench.hub.index import read_index
from oysterbench.hub.model import read_model
from oysterbench.hub.pages import SCRIPT
from oysterbench.hub.publish_model import publish_model, write_released
from oysterbench.hub.verify import ABSENT, DAMAGED, RIGHT, UNKNOWN, checks
from oysterbench.hub.weights import fetch_weights, there_bytes, weights_here
from oysterbench.notebook.doctor.data import look_at_data
from tests.helpers.blobs import CALM
from tests.helpers.trees import FACTS, a_key, oysterbench_serve, publish_split, tree_bytes, write_split
from tests.helpers.web import Honest, misbehaving, serving
from tests.helpers.weights_made import FIGURE, PIECE, SIZE, TRAINING, card_of, release, write_weights


class Released:
    """A tree with two versions of a model, its key, and the files."""

    def __init__(self, folder):
        self.folder, self.tree = folder, folder / "tree"
        self.key, self.public = a_key(folder)
        self.files = {version: write_weights(folder / f"{version}.pt", k) for k, version in enumerate(("1.0", "1.1"))}
        self.cards = {version: release(self.tree, path, self.key, version) for version, path in self.files.items()}

    @property
    def site(self):
        return tree_bytes(self.tree)

    def hub(self, *places, public=None, **options):
        return Hub.at([str(place) for place in places or [self.tree]], public or self.public, patience=CALM, **options)


@pytest.fixture(scope="module")
def released(tmp_path_factory):
    return Released(tmp_path_factory.mktemp("models"))


@pytest.fixture(autouse=True)
def _own_home(home):
    """No test sees what another one remembered."""


# Publishing


def test_a_model_is_addressed_by_content_and_named_by_the_signed_index(released):
    found = released.site
    for path, data in found.items():
        folder, _, name = path.rpartition("/")
        if folder:
            assert name.partition(".")[0] == sha256(data), path
    index = read_index(found["index.json"], released.public, "index")
    assert list(index.models["unet"]) == ["1.0", "1.1"]
    one, card = index.models["unet"]["1.0"], released.cards["1.0"]
    assert (one.card, one.size, one.card_size) == (card.sha256, SIZE, len(card.data))
    assert read_model(found[f"models/{one.card}.json"], "card") == card
    assert found[f"blobs/{card.file.sha256}"] == released.files["1.0"].read_bytes()
    assert (card.training, card.figures) == (TRAINING, (FIGURE,))


def test_publishing_a_model_twice_adds_nothing_and_a_release_never_changes(released, tmp_path):
    shutil.copytree(released.tree, tmp_path / "tree")
    before = tree_bytes(tmp_path / "tree")
    release(tmp_path / "tree", released.files["1.0"], released.key)
    assert tree_bytes(tmp_path / "tree") == before
    with pytest.raises(HubError, match=r"a release never changes; .* another --version"):
        release(tmp_path / "tree", released.files["1.1"], released.key, "1.0")
    other = card_of(released.files["1.0"], summary="Something better")
    with pytest.raises(HubError, match=r"a release never changes"):
        publish_model(tmp_path / "tree", other, released.files["1.0"], released.key)
    assert tree_bytes(tmp_path / "tree") == before


def test_a_later_oysterbench_publishes_the_same_card_again(tmp_path, monkeypatch):
    path, (key, _) = write_weights(tmp_path / "unet.pt"), a_key(tmp_path)
    model = release(tmp_path / "tree", path, key)
    monkeypatch.setattr("oysterbench.hub.publish_model.VERSION", "99.0")
    assert release(tmp_path / "tree", path, key) == model
    write_released(model, path, tmp_path / "package")
    write_released(card_of(path), path, tmp_path / "package")
    assert (tmp_path / "package" / "unet.json").read_bytes() == model.data
    with pytest.raises(HubError, match="a release never changes"):
        publish_model(tmp_path / "tree", card_of(path, summary="Others"), path, key)


@pytest.mark.parametrize("kind", ["models", "cards"])
def test_a_lost_card_or_its_page_is_made_again(tmp_path, monkeypatch, kind):
    path, (key, _) = write_weights(tmp_path / "unet.pt"), a_key(tmp_path)
    release(tmp_path / "tree", path, key)
    before = tree_bytes(tmp_path / "tree")
    (lost,) = (tmp_path / "tree" / kind).iterdir()
    lost.write_bytes(lost.read_bytes()[:-2])
    monkeypatch.setattr("oysterbench.hub.publish_model.VERSION", "99.0")
    with pytest.raises(HubError, match=r"a release never changes|copy it from a mirror of the tree"):
        publish_model(tmp_path / "tree", card_of(path, summary="Others"), path, key)
    release(tmp_path / "tree", path, key)
    assert tree_bytes(tmp_path / "tree") == before


def test_a_file_that_changes_while_it_is_published_is_not_released(released, tmp_path):
    card = card_of(released.files["1.0"])
    with pytest.raises(HubError, match="changed while it was published"):
        publish_model(tmp_path, card, released.files["1.1"], released.key)
    assert not (tmp_path / "index.json").exists()


def test_splits_and_models_share_a_tree_but_no_name(tmp_path):
    key, public = a_key(tmp_path)
    weights, files = write_weights(tmp_path / "a.pt"), write_split(tmp_path / "data")
    without = json.loads(
        (publish_split(tmp_path / "tree", files, key), (tmp_path / "tree" / "index.json").read_bytes())[1]
    )
    assert "models" not in without["signed"]  # the index of a hub without models is what it always was
    with pytest.raises(HubError, match="a split in"):
        release(tmp_path / "tree", weights, key, name=FACTS["split"])
    release(tmp_path / "tree", weights, key)
    with pytest.raises(HubError, match="a model in"):
        publish_split(tmp_path / "tree", files, key, split="unet")
    hub = Hub.at([str(tmp_path / "tree")], public)
    assert hub.manifest("fake-val").version == hub.model("unet").version == "1.0"
    assert (hub.has_model("unet"), hub.has_model("fake-val")) == (True, False)


def test_verify_reads_every_file_of_a_model_in_a_tree(released, tmp_path):
    tree = tmp_path / "tree"
    shutil.copytree(released.tree, tree)
    assert {check.state for check in checks(str(tree))} == {RIGHT}
    card = released.cards["1.0"]
    blob = tree / "blobs" / card.file.sha256
    blob.write_bytes(blob.read_bytes()[:-1] + b"?")
    (tree / "models" / f"{released.cards['1.1'].sha256}.json").unlink()
    states = {check.path: check.state for check in checks(str(tree)) if not check.good}
    assert states == {blob: DAMAGED, tree / "models" / f"{released.cards['1.1'].sha256}.json": ABSENT}


def test_the_pages_say_what_the_card_says(released):
    index = (released.tree / "index.html").read_text()
    assert "oysterbench download unet@1.1" in index
    (page,) = (path.read_text() for path in (released.tree / "cards").iterdir() if "unet 1.0" in path.read_text())
    for text in (
        "seg-train",
        "EfficientNet-lite0",
        "Apache License 2.0",
        "0.712 (0.690 to 0.730)",
        "seg-val",
        "1000 steps",
    ):
        assert text in page, text
    assert f"../blobs/{released.cards['1.0'].file.sha256}" in page
    assert "<script" not in page


def test_a_card_is_escaped_where_it_is_shown(tmp_path):
    key, _ = a_key(tmp_path)
    path = write_weights(tmp_path / "a.pt")
    publish_model(tmp_path / "tree", card_of(path, summary="<script>alert(1)</script>"), path, key)
    pages = [tmp_path / "tree" / "index.html", *(tmp_path / "tree" / "cards").iterdir()]
    assert all("<script" not in page.read_text().replace(f"<script>{SCRIPT}</script>", "") for page in pages)


# Fetching


def test_weights_come_whole_over_http_with_their_card(released, tmp_path):
    seen = []
    with oysterbench_serve(released.tree) as url:
        hub = released.hub(url)
        card = hub.model("unet", "1.0")
        path = fetch_weights(hub, card, tmp_path / "a" / "unet.pt", progress=lambda *count: seen.append(count))
    assert path.read_bytes() == released.files["1.0"].read_bytes()
    assert (seen[0], seen[-1]) == ((0, SIZE), (SIZE, SIZE))
    here = weights_here(path)
    assert (here.model, here.sha256, here.brief) == (card, card.file.sha256, "1.0")
    assert sorted(file.name for file in path.parent.iterdir() if file.suffix != ".lock") == ["unet.json", "unet.pt"]
    assert [check.state for check in checks(str(path))] == [RIGHT]


def test_what_is_here_is_not_fetched_again(released, tmp_path):
    with serving(Honest, released.site) as site:
        hub = released.hub(site.url)
        card = hub.model("unet")
        fetch_weights(hub, card, tmp_path / "unet.pt")
        (tmp_path / "unet.json").unlink()
        sent = site.sent
        fetch_weights(hub, card, tmp_path / "unet.pt")
        assert site.sent == sent
    assert (tmp_path / "unet.json").read_bytes() == card.data


def test_an_interrupted_download_goes_on_where_it_was(released, tmp_path):
    """The server breaks off after a third of the file; what was fetched is not fetched again."""
    path = tmp_path / "unet.pt"

    class Breaks(Honest):
        def give(self, data, start, end, **headers):
            if not self.path.startswith("/blobs/") or start < SIZE // 3:
                super().give(data, start, end, **headers)
            else:
                self.cut_off()

    with serving(Breaks, released.site) as site:
        hub = released.hub(site.url, connections=1)
        with pytest.raises(NetworkError, match="the same command resumes from there"):
            fetch_weights(hub, hub.model("unet"), path)
    card = released.cards["1.1"]
    assert not path.exists()
    kept = there_bytes(path, card.file)
    assert 0 < kept < SIZE
    with serving(Honest, released.site) as site:
        hub = released.hub(site.url)
        fetch_weights(hub, hub.model("unet"), path)
        of_blob = sum(end - start for name, start, end in site.requests if name.startswith("blobs/"))
    assert path.read_bytes() == released.files["1.1"].read_bytes()
    assert of_blob <= SIZE - kept + PIECE
    assert not part_path(tmp_path, card.file).exists()


def test_of_two_mirrors_one_may_be_broken(released, tmp_path):
    """One gives wrong bytes or none, the other what the index names."""
    site = {name: data for name, data in released.site.items() if name.startswith("blobs/")}
    for kind in ("wrong_bytes", "cut", "unavailable"):
        with misbehaving(kind, site, 1, 1.0) as bad, serving(Honest, released.site) as good:
            hub = released.hub(bad.url, good.url)
            path = fetch_weights(hub, hub.model("unet"), tmp_path / kind / "unet.pt")
        assert any(name.startswith("blobs/") for name, _, _ in bad.requests)
        assert path.read_bytes() == released.files["1.1"].read_bytes()


def test_tampered_weights_are_refused_and_nothing_appears(released, tmp_path):
    site = released.site
    card = released.cards["1.1"]
    data = site[f"blobs/{card.file.sha256}"]
    site[f"blobs/{card.file.sha256}"] = data[: SIZE // 2] + bytes([data[SIZE // 2] ^ 1]) + data[SIZE // 2 + 1 :]
    with serving(Honest, site) as server:
        hub = released.hub(server.url)
        with pytest.raises(IntegrityError, match="wrong bytes"):
            fetch_weights(hub, hub.model("unet"), tmp_path / "unet.pt")
    assert not (tmp_path / "unet.pt").exists()
    assert not (tmp_path / "unet.json").exists()


def test_a_tampered_card_is_refused(released):
    site = released.site
    card = released.cards["1.1"]
    changed = msgspec.structs.replace(card, file=released.cards["1.0"].file)
    site[f"models/{card.sha256}.json"] = changed.data
    with serving(Honest, site) as server, pytest.raises(IntegrityError, match="expected a card with SHA-256"):
        released.hub(server.url).model("unet")


def test_an_index_that_another_key_signed_is_refused(released, tmp_path):
    other, _ = a_key(tmp_path)
    release(tmp_path / "tree", released.files["1.0"], other)
    with pytest.raises(IntegrityError, match="not signed with the key"):
        released.hub(tmp_path / "tree").model("unet")


def test_a_model_without_a_known_key_is_not_looked_for(released):
    hub = Hub.at([str(released.tree)], None)
    assert not hub.has_model("unet")
    with pytest.raises(HubError, match="its public key is not known here"):
        hub.model("unet")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("name", "../unet"),
        ("name", ".unet"),
        ("version", "../1"),
        ("file", {"name": "../../unet.pt"}),
        ("file", {"name": "unet.py"}),
        ("file", {"size": -1}),
        ("file", {"size": 1}),
        ("file", {"pieces": ["x"]}),
        ("file", {"piece_size": 1 << 40}),
        ("format", "oysterbench-model/2"),
    ],
)
def test_cards_whose_names_lead_elsewhere_or_whose_numbers_do_not_fit_are_refused(released, key, value):
    document = json.loads(released.cards["1.0"].data)
    document[key] = {**document[key], **value} if isinstance(value, dict) else value
    with pytest.raises(IntegrityError, match=r"^the card: "):
        read_model(canonical(document), "the card")


def test_names_and_versions_that_are_not_there_are_named_with_those_that_are(released):
    hub = released.hub()
    assert hub.model("unet").version == "1.1"  # the newest
    with pytest.raises(HubError, match=r"no version '2' of unet; it has 1\.0, 1\.1"):
        hub.model("unet", "2")
    with pytest.raises(HubError, match=r"no split or model 'unett'; it has unet"):
        hub.model("unett")


# What is here already


def test_a_newer_version_takes_the_place_of_one_that_a_hub_gave(released, tmp_path):
    hub, path = released.hub(), tmp_path / "unet.pt"
    for version in ("1.0", "1.1", "1.0"):
        fetch_weights(hub, hub.model("unet", version), path)
        assert path.read_bytes() == released.files[version].read_bytes()
        assert weights_here(path).brief == version


@pytest.mark.parametrize("card", [False, True])
def test_weights_of_ones_own_are_replaced_only_where_it_is_asked_for(released, tmp_path, card):
    """Also where the card of weights that were fetched before still lies beside them."""
    hub, path = released.hub(), write_weights(tmp_path / "unet.pt", 9)
    if card:
        path.with_suffix(".json").write_bytes(released.cards["1.0"].data)
    with pytest.raises(HubError, match=r"left unchanged: --again replaces them with unet 1\.1, --out"):
        fetch_weights(hub, hub.model("unet"), path)
    assert path.read_bytes() == write_weights(tmp_path / "same.pt", 9).read_bytes()
    assert weights_here(path).model is None
    fetch_weights(hub, hub.model("unet"), path, again=True)
    assert path.read_bytes() == released.files["1.1"].read_bytes()


def test_a_damaged_card_stops_nothing_and_is_repaired(released, home):
    path = home / "models" / "unet.pt"
    card = path.with_suffix(".json")
    fetch_weights(released.hub(), released.cards["1.0"], path)
    card.write_bytes(card.read_bytes()[:-40])
    (check,) = checks("unet")
    assert (check.path, check.state) == (card, DAMAGED)
    assert "`oysterbench download unet --again`" in check.detail
    assert weights_here(path).model is None
    assert [finding.state for finding in look_at_data() if finding.name == "weights unet"] == ["broken"]
    fetch_weights(released.hub(), released.cards["1.1"], path, again=True)
    assert [check.state for check in checks("unet")] == [RIGHT]


def test_a_file_with_the_name_of_a_card_is_replaced_only_where_it_is_asked_for(released, tmp_path):
    mine = tmp_path / "unet.json"
    mine.write_text('{"mine": 1}')
    with pytest.raises(HubError, match=r"unet\.json: a different file has this name"):
        fetch_weights(released.hub(), released.cards["1.0"], tmp_path / "unet.pt")
    assert mine.read_text() == '{"mine": 1}'
    fetch_weights(released.hub(), released.cards["1.0"], tmp_path / "unet.pt", again=True)
    assert mine.read_bytes() == released.cards["1.0"].data


def test_a_failed_download_leaves_the_version_that_was_there(released, tmp_path):
    path = tmp_path / "unet.pt"
    fetch_weights(released.hub(), released.cards["1.0"], path)
    site = released.site
    del site[f"blobs/{released.cards['1.1'].file.sha256}"]
    with serving(Honest, site) as server:
        hub = released.hub(server.url)
        with pytest.raises(NetworkError):
            fetch_weights(hub, hub.model("unet"), path)
    assert path.read_bytes() == released.files["1.0"].read_bytes()
    assert weights_here(path).brief == "1.0"


def test_verify_tells_fetched_weights_that_are_damaged_from_ones_own(released, home):
    path = home / "models" / "unet.pt"
    fetch_weights(released.hub(), released.cards["1.0"], path)
    write_weights(home / "models" / "mine.pt")
    assert {check.path.name: check.state for check in checks()} == {"mine.pt": UNKNOWN, "unet.pt": RIGHT}
    path.write_bytes(path.read_bytes()[:-1])
    (check,) = checks("unet")
    assert (check.state, check.good) == (DAMAGED, False)
    assert "download unet --again" in check.detail


def test_verify_knows_the_weights_that_are_part_of_oysterbench(released, home, tmp_path, monkeypatch):
    write_released(released.cards["1.0"], released.files["1.0"], tmp_path)
    monkeypatch.setattr("oysterbench.hub.verify.released_models", lambda: tmp_path)
    path = tmp_path / "unet.pt"
    assert [(check.path, check.state) for check in checks("unet")] == [(path, RIGHT)]
    path.write_bytes(path.read_bytes()[:-1])
    (check,) = checks("unet")
    assert (check.state, check.detail.endswith("it is part of oysterbench: install that again")) == (DAMAGED, True)
    write_weights(home / "models" / "unet.pt")  # which methods run on instead
    assert [check.path for check in checks("unet")] == [home / "models" / "unet.pt"]
