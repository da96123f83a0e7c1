"""Files that are here under a name of a split: those that can be used are kept, whatever becomes of the hub."""

from __future__ import annotations

import pytest

from oysterbench.core.errors import HubError
from oysterbench.hub.download import Hub, all_here, download
from tests.helpers.trees import assert_same, hub_at, write_sequence, write_split


@pytest.fixture(autouse=True)
def _own_home(home):
    """No test sees what another one remembered."""


@pytest.fixture
def filled(published, home):
    """A folder under the home that a download filled."""
    folder = home / "splits" / "fake-val" / "1.0-x"
    download(hub_at(published, published.tree), published.manifest, folder)
    return folder


@pytest.mark.parametrize("verify", [False, True])
def test_a_usable_file_of_other_bytes_is_kept(published, filled, verify):
    """Such as one that was rendered with another version of the compressor: no hub is asked for a replacement."""
    path = write_sequence(filled / "dive-01.mcap", "dive-01", compress=False)
    packed = path.read_bytes()
    assert len(packed) != published.manifest.files[0].size
    for _ in range(2):
        files = download(Hub([], None), published.manifest, filled, verify=verify)
        assert files["dive-01"].read_bytes() == packed
    assert not list(filled.glob(".*.part"))


@pytest.mark.parametrize("verify", [False, True])
def test_another_file_in_a_folder_that_was_filled_here_is_left_alone(published, filled, verify):
    path = write_sequence(filled / "dive-01.mcap", "dive-01", 0.5)
    mine = path.read_bytes()
    with pytest.raises(HubError, match=r"dive-01\.mcap: a different file has this name .*it was left unchanged"):
        download(hub_at(published, published.tree), published.manifest, filled, verify=verify)
    assert path.read_bytes() == mine
    assert all_here("fake-val", "1.0") == []


@pytest.mark.parametrize("size", [-100, 5000])
def test_a_damaged_file_that_was_rendered_is_repaired_as_it_says_which_one_it_is(published, tmp_path, size):
    """There is no manifest beside rendered files. A file of another recipe is left alone."""
    write_split(tmp_path)
    path = tmp_path / "dive-01.mcap"
    path.write_bytes(path.read_bytes()[:size])
    assert_same(download(hub_at(published, published.tree), published.manifest, tmp_path), published)
    (tmp_path / "manifest.json").unlink()
    other = write_sequence(path, "dive-01", digest="0" * 64).read_bytes()[:size]
    path.write_bytes(other)
    with pytest.raises(HubError, match=r"dive-01\.mcap: a different file has this name .*it was left unchanged"):
        download(hub_at(published, published.tree), published.manifest, tmp_path, verify=True)
    assert path.read_bytes() == other


def test_a_truncated_file_in_a_folder_that_was_filled_here_is_fetched_again(published, filled):
    path = filled / "dive-01.mcap"
    path.write_bytes(path.read_bytes()[:-100])
    assert_same(download(hub_at(published, published.tree), published.manifest, filled), published)
