"""The commands of those who use a hub, as they are typed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import oysterbench
from oysterbench.hub.manifest import build_manifest
from oysterbench.recipe import load_split
from oysterbench.sequence.cut import cut_to
from oysterbench.simulation.generate import digest
from tests.helpers.hub_place import Place
from tests.helpers.trees import FACTS, oysterbench_serve, write_bag, write_sequence


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return Place(tmp_path_factory.mktemp("commands"))


def test_from_publish_to_verify_over_http(place):
    with oysterbench_serve(place.tree) as url:
        hub = {"OYSTERBENCH_HUB": url, "OYSTERBENCH_HUB_KEY": place.public}
        plan = json.loads(place.run("download", place.recipe, "--dry-run", "--json", **hub).stdout)
        assert plan["files"][0]["state"] == "to fetch"
        assert not (place.home / "splits").exists()
        done = place.run("download", place.recipe, **hub)
    path = Path(done.stdout.strip())
    assert path.read_bytes() == place.whole
    assert "\x1b" not in done.stderr  # no animation off a terminal
    assert "downloading tiny: 0." in done.stderr
    assert place.run("verify").stdout == f"{path}: right\n"
    assert place.run("verify", "tiny").stdout == f"{path}: right\n"
    # A downloaded split is where a rendered one would be.
    rendered = place.run("render", place.recipe)
    assert rendered.stdout.strip() == str(path)


def test_offline_gives_what_is_here(place, tmp_path):
    place.run("download", place.recipe, "--from", place.tree, "--key", place.public, home=tmp_path)
    hub = {"OYSTERBENCH_HUB": "http://127.0.0.1:9", "OYSTERBENCH_OFFLINE": "1"}
    done = place.run("download", place.recipe, home=tmp_path, **hub)
    assert Path(done.stdout.strip()).read_bytes() == place.whole
    assert "tiny-01" in place.run("download", "tiny@1.0", "--json", home=tmp_path, **hub).stdout
    again = place.run("download", place.recipe, "--from", place.tree, "--key", place.public, home=tmp_path)
    assert (again.stdout, again.stderr) == (done.stdout, "")
    failed = place.run("download", "tiny@2.0", home=tmp_path, code=4, **hub)
    assert failed.stderr.startswith("oysterbench: http://127.0.0.1:9: OYSTERBENCH_OFFLINE is set")


def test_a_hub_that_lacks_a_file_is_said_to_and_what_renders_it(place, tmp_path):
    shutil.copytree(place.tree, tmp_path / "tree")
    shutil.rmtree(tmp_path / "tree" / "blobs")
    words = ("download", place.recipe, "--from", tmp_path / "tree", "--key", place.public)
    failed = place.run(*words, home=tmp_path / "home", code=4)
    (line,) = (one for one in failed.stderr.splitlines() if one.startswith("oysterbench: "))
    assert "does the hub have it? `oysterbench splits --hub` and" in line
    assert line.endswith("; `oysterbench render tiny` makes the same files")
    assert "resumes" not in line


def test_a_manifest_from_elsewhere_is_held_against_the_hub(place, tmp_path):
    forged = write_sequence(tmp_path / "usb" / "tiny-01.mcap", "tiny-01", 0.3)
    facts = {**FACTS, "split": "tiny"}
    (tmp_path / "usb" / "manifest.json").write_bytes(build_manifest(facts, {"tiny-01": forged}).data)
    hub = ("--out", tmp_path / "usb", "--from", place.tree, "--key", place.public)
    failed = place.run("download", "tiny@1.0", *hub, home=tmp_path / "home", code=1)
    assert f"{forged}: a different file has this name" in failed.stderr


def test_a_damaged_file_beside_the_right_manifest_is_repaired_where_nothing_was_downloaded_before(place, tmp_path):
    hub, home = ("--from", place.tree, "--key", place.public), tmp_path / "home"
    place.run("download", "tiny@1.0", *hub, "--out", tmp_path / "own", home=home)
    shutil.copytree(tmp_path / "own", tmp_path / "usb")
    path = tmp_path / "usb" / "tiny-01.mcap"
    path.write_bytes(place.whole[:-9] + b"x" + place.whole[-8:])
    done = place.run("download", "tiny@1.0", *hub, "--out", tmp_path / "usb", home=home)
    assert f"{path}: damaged (1 of 1 pieces" in done.stderr
    assert path.read_bytes() == place.whole


def test_files_that_are_here_are_named_where_no_hub_vouches_for_their_manifest(place, tmp_path):
    shutil.copytree(place.data, tmp_path / "usb")
    manifest = build_manifest({**FACTS, "split": "tiny"}, {"tiny-01": tmp_path / "usb" / "tiny-01.mcap"})
    (tmp_path / "usb" / "manifest.json").write_bytes(manifest.data)
    command, key = ("download", "tiny@1.0", "--out", tmp_path / "usb", "--from"), ("--key", place.public)
    for code, *hub in (
        (1, tmp_path / "gone", *key),
        (4, "http://127.0.0.1:9", *key),
        (1, place.tree),
    ):
        line = place.run(*command, *hub, home=tmp_path, code=code).stderr
        assert f"; the files are in {tmp_path / 'usb'}, by a manifest that no key vouches for here" in line
        assert line.count("\n") == 1
    forger = place.run(*command, place.tree, "--key", "ab" * 32, home=tmp_path, code=3).stderr
    assert "OYSTERBENCH_OFFLINE" not in forger  # wrong bytes are no reason to check less
    done = place.run(*command, "http://127.0.0.1:9", home=tmp_path, OYSTERBENCH_OFFLINE="1")
    assert done.stdout.strip() == str(tmp_path / "usb" / "tiny-01.mcap")


def test_topics_and_out(place, tmp_path):
    arguments = ("--from", place.tree, "--key", place.public, "--out", tmp_path / "small", "--topics", "/imu")
    done = place.run("download", place.recipe, *arguments, home=tmp_path / "home")
    assert done.stdout.strip() == str(tmp_path / "small" / "tiny-01.mcap")
    topics = json.loads(place.run("info", tmp_path / "small" / "tiny-01.mcap", "--json").stdout)["topics"]
    assert [row["topic"] for row in topics] == ["/imu"]


def test_a_damaged_file_ends_with_3_and_is_repaired(place, tmp_path):
    hub = ("--from", place.tree, "--key", place.public)
    path = Path(place.run("download", place.recipe, *hub, home=tmp_path).stdout.strip())
    path.write_bytes(place.whole[:-9] + b"x" + place.whole[-8:])
    for what in ((), ("tiny",), (path,)):
        failed = place.run("verify", *what, code=3, home=tmp_path)
        assert f"{path}: damaged (1 of 1 pieces" in failed.stdout
        assert "--verify" in failed.stderr
    place.run("download", place.recipe, "--verify", *hub, home=tmp_path)
    assert place.run("verify", home=tmp_path).stdout == f"{path}: right\n"
    path.unlink()
    assert "absent" in place.run("verify", code=3, home=tmp_path).stdout


def test_errors_are_one_line_with_their_code(place, tmp_path):
    def line(code, *arguments, **environment):
        done = place.run(*arguments, code=code, home=tmp_path, **environment)
        assert done.stdout == ""
        assert done.stderr.count("\n") == 1, done.stderr
        return done.stderr

    key = ("--key", place.public)
    none = line(4, "download", "tiny", "--from", "http://127.0.0.1:9/", *key)
    assert none.endswith("http://127.0.0.1:9: no answer: Connection refused, 3 times in a row\n")
    assert "not signed" in line(3, "download", "tiny", "--from", place.tree, "--key", "ab" * 32)
    no_key = line(1, "download", "tiny", "--from", place.tree)
    assert no_key.startswith(f"oysterbench: {place.tree}: its public key is not known here")
    assert "add --key KEY" in no_key
    assert f"{tmp_path}: this folder holds no published tree" in line(1, "download", "tiny", "--from", tmp_path, *key)
    assert "no split or model 'slam-max'; it has tiny" in line(1, "download", "slam-max", "--from", place.tree, *key)
    assert "no hub is set" in line(1, "download", "slam-max")
    assert "no such key" in line(1, "publish", place.recipe, tmp_path / "x", "--key", tmp_path / "no.pem")
    assert "oysterbench render" in line(1, "publish", place.recipe, tmp_path / "x", "--key", place.folder / "key.pem")
    assert "index.json is absent" in line(1, "serve", tmp_path)
    unknown = "no such file, folder, split or weights; "
    assert f"nothing: {unknown}`oysterbench splits` lists" in line(1, "verify", "nothing")
    assert f"slam-max: {unknown}did you mean slam-" in line(1, "verify", "slam-max")
    assert "no data of it is here; `oysterbench download slam-train`" in line(1, "verify", "slam-train")
    assert f"{unknown}did you mean slam-train or " in line(1, "verify", "slam-trian")
    place.run("publish", place.recipe, tmp_path, "--key", place.folder / "key.pem", "--hidden", code=2)


@pytest.mark.parametrize("command", [("download", "moving"), ("models", "--hub"), ("splits", "--hub")])
def test_empty_variables_are_a_hub_that_is_not_set_and_the_line_says_what_to_type(place, command):
    options = ("--from", "", "--key", "")
    for more, variables in ((options, {}), ((), {"OYSTERBENCH_HUB": "", "OYSTERBENCH_HUB_KEY": ""})):
        line = place.run(*command, *more, code=1, **variables).stderr
        assert "no hub is set (--from, OYSTERBENCH_HUB or hub.toml in the home folder)" in line
        assert "name one, with its public key: --from URL --key KEY" in line


def test_without_a_hub_the_split_is_rendered_and_it_says_so(place, tmp_path):
    done = place.run("download", place.recipe, "--dry-run", home=tmp_path)
    assert "no hub is set" in done.stderr
    assert "would be rendered" in done.stderr
    # With the files there already, rendering only checks them.
    out = tmp_path / "out"
    place.write(out, digest(load_split(str(place.recipe))))
    done = place.run("download", place.recipe, "--out", out, home=tmp_path)
    assert done.stdout.strip() == str(out / "tiny-01.mcap")
    assert "rendered instead, which gives the same bytes" in done.stderr


@pytest.mark.parametrize("topics", [(), ("--topics", "/imu")])
def test_without_a_hub_verify_renders_damaged_files_again(place, tmp_path, monkeypatch, topics):
    path = tmp_path / "out" / "tiny-01.mcap"
    place.write(tmp_path / "whole", digest(load_split(str(place.recipe))))
    cut_to(
        path,
        tmp_path / "whole" / "tiny-01.mcap",
        ["/imu"] if topics else oysterbench.open(tmp_path / "whole" / "tiny-01.mcap").types,
    )
    whole = path.read_bytes()
    rendered = []

    def render(split, folder, *rest, **more):
        rendered.append(path.exists())
        path.write_bytes(whole)
        return {"tiny-01": path}

    monkeypatch.setattr("oysterbench.cli.render.render_files", render)
    words = ("download", place.recipe, "--verify", "--out", path.parent, *topics)
    assert "damaged" not in place.run(*words, home=tmp_path).stderr
    path.write_bytes(whole[:-100])
    assert f"{path}: damaged (" in place.run(*words, home=tmp_path).stderr
    assert rendered == [True, False]
    assert path.read_bytes() == whole


@pytest.mark.parametrize("mine", ["notes", "bag", "other recipe"])
def test_without_a_hub_verify_leaves_files_alone_that_may_be_somebodys_own(place, tmp_path, monkeypatch, mine):
    path = tmp_path / "tiny-01.mcap"
    if mine == "bag":
        write_bag(path)
    else:
        place.write(tmp_path, "0" * 64)
        path.write_bytes(b"my notes" if mine == "notes" else path.read_bytes()[:-100])
    data = path.read_bytes()
    monkeypatch.setattr("oysterbench.cli.render.render_files", lambda *given, **more: pytest.fail("rendered"))
    line = place.run("download", place.recipe, "--verify", "--out", tmp_path, home=tmp_path / "home", code=1).stderr
    assert f"oysterbench: {path}: expected tiny-01 of tiny 1.0, as its recipe makes it, got" in line
    assert "it was left unchanged: delete it or choose another folder with --out" in line
    assert [one.name for one in tmp_path.iterdir() if one.is_file()] == ["tiny-01.mcap"]
    assert path.read_bytes() == data


def test_a_damaged_file_is_gone_only_once_another_is_complete(place, tmp_path, monkeypatch):
    path, aside = tmp_path / "tiny-01.mcap", tmp_path / ".tiny-01.mcap.damaged"
    place.write(tmp_path, digest(load_split(str(place.recipe))))
    whole = path.read_bytes()
    path.write_bytes(whole[:-100])

    def stopped(*given, **more):
        assert (path.exists(), aside.read_bytes()) == (False, whole[:-100])
        raise OSError(28, "No space left on device")

    words = ("download", place.recipe, "--verify", "--out", tmp_path)
    monkeypatch.setattr("oysterbench.cli.render.render_files", stopped)
    place.run(*words, home=tmp_path / "home", code=1)
    assert (path.read_bytes(), aside.exists()) == (whole[:-100], False)
    path.rename(aside)  # as a kill leaves it
    monkeypatch.setattr(
        "oysterbench.cli.render.render_files", lambda *given, **more: [path.write_bytes(whole), {"tiny-01": path}][1]
    )
    line = place.run("verify", tmp_path, code=3).stdout
    assert line == f"{aside}: damaged (set aside by a repair that was interrupted: delete it)\n"
    smaller = tmp_path / "topics-e3154fbf" / aside.name
    smaller.parent.mkdir()
    smaller.write_bytes(b"cut off")
    assert f"{smaller}: damaged (set aside by" in place.run("verify", tmp_path, code=3).stdout
    shutil.rmtree(smaller.parent)
    place.run(*words, home=tmp_path / "home")
    assert (path.read_bytes(), aside.exists()) == (whole, False)
    aside.write_bytes(whole[:-100])  # and if its file was rendered by another command
    place.run("download", place.recipe, "--out", tmp_path, home=tmp_path / "home")
    assert (path.read_bytes(), aside.exists()) == (whole, False)


def test_without_a_hub_verify_cuts_no_topics_from_a_damaged_file(place, tmp_path, monkeypatch):
    split = load_split(str(place.recipe))
    path = tmp_path / "splits" / "tiny" / f"1.0-{digest(split)[:12]}" / "tiny-01.mcap"
    place.write(path.parent, digest(split))
    damaged = path.read_bytes()[:-100]
    path.write_bytes(damaged)
    there = []
    monkeypatch.setattr("oysterbench.cli.render.render_files", lambda *given, **more: there.append(path.exists()) or {})
    line = place.run("download", place.recipe, "--verify", "--topics", "/imu", home=tmp_path).stderr
    assert f"{path}: damaged (" in line
    assert "); it is not used now, and stays: --verify without --topics renders it again" in line
    assert there == [False]
    assert path.read_bytes() == damaged  # until somebody asks for it


def test_splits_tells_what_is_here_and_what_the_hub_has(place, tmp_path, monkeypatch):
    monkeypatch.setattr("oysterbench.recipe.split_names", lambda: ["slam-mini"])  # one of its own beside the hub's

    def rows(*arguments):
        found = json.loads(place.run("splits", "--json", *arguments, home=tmp_path).stdout)["splits"]
        return {(row["name"], row["version"]): row for row in found}

    hub = ("--from", place.tree, "--key", place.public)
    assert ("tiny", "1.0") not in rows()
    row = rows(*hub)["tiny", "1.0"]
    assert (row["complete"], row["size_bytes"], row["full_bytes"]) == (False, 0, len(place.whole))
    assert row["hub_bytes"] == len(place.whole)
    heads = [place.run("splits", *words, home=tmp_path).stdout.split("what")[0].split() for words in ((), hub)]
    assert [head[-1] for head in heads] == ["here", "hub"]
    place.run("download", "tiny", *hub, home=tmp_path)
    for arguments in ((), hub):
        row = rows(*arguments)["tiny", "1.0"]
        assert (row["complete"], row["size_bytes"], row["here"]) == (True, len(place.whole), 1)
    assert "tiny 1.0" in place.run("splits", home=tmp_path).stdout
    Path(row["folder"], "tiny-01.mcap").unlink()
    assert rows()["tiny", "1.0"]["complete"] is False
    assert "no hub is set" in place.run("splits", "--hub", home=tmp_path, code=1).stderr
