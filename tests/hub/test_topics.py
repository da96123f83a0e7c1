"""Smaller files with some topics of a split: made again only where they are not here, beside other processes."""

from __future__ import annotations

import threading

import pytest

from oysterbench.core.errors import HubError
from oysterbench.hub import topics as smaller
from oysterbench.hub.download import Hub, download, part_path
from oysterbench.hub.part import Part
from oysterbench.hub.topics import fetch_topics, plan_topics
from oysterbench.sequence.file import read_messages
from tests.helpers.trees import assert_same, hub_at

NOWHERE = Hub([], None)
"""A hub that has nothing: what succeeds with it has fetched nothing."""


@pytest.fixture(autouse=True)
def _own_home(home):
    """No test sees what another one remembered."""


@pytest.mark.parametrize("out", ["topics", None])
def test_the_same_command_takes_the_smaller_files_that_are_here_and_makes_the_rest(published, tmp_path, out):
    entries, folder = published.manifest.files, tmp_path / "topics"
    out = out and folder
    files = fetch_topics(hub_at(published, published.tree), entries[:1], folder, ["/imu"], out)
    before = files["dive-01"].stat()
    assert plan_topics(NOWHERE, entries[:1], folder, ["/imu"], out) == {"dive-01": 0}
    assert fetch_topics(NOWHERE, entries[:1], folder, ["/imu"], out) == files
    files = fetch_topics(hub_at(published, published.tree), entries, folder, ["/imu"], out)
    assert list(files) == ["dive-01", "dive-02"]
    assert files["dive-01"].stat().st_mtime_ns == before.st_mtime_ns
    for name, path in files.items():
        assert list(read_messages(path)) == list(read_messages(published.files[name], ["/imu"]))


def test_a_file_with_other_topics_is_left_alone_and_said_to_be_that(published, tmp_path):
    hub, entries = hub_at(published, published.tree), published.manifest.files[:1]
    path = fetch_topics(hub, entries, tmp_path, ["/imu"], tmp_path)["dive-01"]
    data = path.read_bytes()
    with pytest.raises(HubError, match=r"dive-01\.mcap: expected none, or a sound one with the same 2 of .* unchanged"):
        fetch_topics(hub, entries, tmp_path, ["/imu", "/pressure"], tmp_path)
    assert path.read_bytes() == data


def test_a_damaged_smaller_file_in_a_folder_of_their_own_is_made_again(published, tmp_path):
    hub, entries = hub_at(published, published.tree), published.manifest.files[:1]
    path = fetch_topics(hub, entries, tmp_path, ["/imu"])["dive-01"]
    data = path.read_bytes()
    for damaged in (data[:-100], data.replace(b"\x00\x00", b"\x00\x01")):
        path.write_bytes(damaged)
        assert fetch_topics(hub, entries, tmp_path, ["/imu"])["dive-01"].read_bytes() == data


def test_with_verify_a_damaged_complete_file_is_passed_over(published, tmp_path):
    hub, entries = hub_at(published, published.tree), published.manifest.files[:1]
    path = download(hub, published.manifest, tmp_path, entries)["dive-01"]
    data = bytearray(path.read_bytes())
    data[len(data) // 3 : len(data) // 3 + 4000] = bytes(4000)
    path.write_bytes(data)
    smaller_file = fetch_topics(hub, entries, tmp_path, ["*"], verify=True)["dive-01"]
    assert list(read_messages(smaller_file)) == list(read_messages(published.files["dive-01"]))
    assert path.read_bytes() == data


def test_what_an_interrupted_call_fetched_is_removed_by_the_next_one_and_parts_of_complete_files_are_not(
    published, tmp_path, monkeypatch
):
    hub, entries = hub_at(published, published.tree), published.manifest.files[:1]
    part = part_path(tmp_path, entries[0])

    def interrupted(*given):
        raise KeyboardInterrupt

    cut_to, install = smaller.cut_to, Part.install
    monkeypatch.setattr(smaller, "cut_to", interrupted)
    with pytest.raises(KeyboardInterrupt):
        fetch_topics(hub, entries, tmp_path, ["/imu"])
    monkeypatch.setattr(smaller, "cut_to", cut_to)
    assert part.exists()
    fetch_topics(hub, entries, tmp_path, ["/imu"])
    assert {path.suffix for path in tmp_path.glob(".*")} <= {".lock"}
    monkeypatch.setattr(smaller, "cut_to", interrupted)
    with pytest.raises(KeyboardInterrupt):
        fetch_topics(hub, entries, tmp_path, ["/imu", "/pressure"])
    monkeypatch.setattr(smaller, "cut_to", cut_to)
    monkeypatch.setattr(Part, "install", interrupted)
    with pytest.raises(KeyboardInterrupt):
        download(hub, published.manifest, tmp_path, entries)
    monkeypatch.setattr(Part, "install", install)
    fetch_topics(hub, entries, tmp_path, ["/imu", "/pressure"])
    assert part.exists()
    download(NOWHERE, published.manifest, tmp_path, entries)  # all of it is in the part


@pytest.mark.parametrize("whole", [True, False])
def test_no_process_loses_the_part_that_another_one_fills(published, tmp_path, monkeypatch, whole):
    """While one cuts /imu from the part, the other wants the whole file, or other topics: it waits."""
    hub, entries = hub_at(published, published.tree), published.manifest.files[:1]
    part = part_path(tmp_path, entries[0])
    cut_to, cutting, opened = smaller.cut_to, threading.Event(), threading.Event()

    def slowly(*given):
        if not cutting.is_set():
            cutting.set()
            assert not opened.wait(0.2), "the part was opened while another process was about to remove it"
        cut_to(*given)

    class Opened(Part):
        def __init__(self, *given):
            if cutting.is_set():
                opened.set()
            super().__init__(*given)

    monkeypatch.setattr(smaller, "cut_to", slowly)
    monkeypatch.setattr(smaller, "Part", Opened)
    monkeypatch.setattr("oysterbench.hub.download.Part", Opened)
    failed = []

    def first():
        try:
            fetch_topics(hub, entries, tmp_path, ["/imu"])
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=first)
    thread.start()
    assert cutting.wait(10)
    if whole:
        files = download(hub, published.manifest, tmp_path)
    else:
        fetch_topics(hub, entries, tmp_path, ["/truth/*"])
    thread.join()
    assert not failed
    assert opened.is_set()
    assert not part.exists()
    if whole:
        assert_same(files, published)
