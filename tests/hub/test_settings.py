"""Where a hub is and which key it is read by: options, environment, file."""

from __future__ import annotations

import os

import pytest

from oysterbench.core.errors import HubError
from oysterbench.hub.settings import hub_key, hub_places
from oysterbench.hub.sign import make_key


def test_settings_come_from_options_then_environment_then_file(home, monkeypatch, tmp_path):
    assert hub_places() == []
    assert hub_key() is None
    home.mkdir()
    public = make_key(tmp_path / "key.pem")
    (home / "hub.toml").write_text(f'url = ["https://a.example", "https://b.example"]\nkey = "{public}"\n')
    assert hub_places() == ["https://a.example", "https://b.example"]
    assert hub_key() == public
    monkeypatch.setenv("OYSTERBENCH_HUB", "https://c.example /mnt/hub")
    monkeypatch.setenv("OYSTERBENCH_HUB_KEY", "ab" * 32)
    assert hub_places() == ["https://c.example", "/mnt/hub"]
    assert hub_key() == "ab" * 32
    assert hub_places(["https://d.example"]) == ["https://d.example"]
    assert hub_key("CD" * 32) == "cd" * 32
    with pytest.raises(HubError, match="--key: expected a hub's public key, 64 hex digits"):
        hub_key("no key")
    monkeypatch.delenv("OYSTERBENCH_HUB")
    for text, message in (("url = 3", "expected an address"), ("= x", "not valid TOML")):
        (home / "hub.toml").write_text(text)
        with pytest.raises(HubError, match=message):
            hub_places()


def test_what_is_empty_is_not_set(home, monkeypatch):
    """As where a shell variable that is typed, or exported, has no value."""
    home.mkdir()
    (home / "hub.toml").write_text(f'url = "https://a.example"\nkey = "{"ab" * 32}"\n')
    for empty in ("", " "):
        monkeypatch.setenv("OYSTERBENCH_HUB", empty)
        monkeypatch.setenv("OYSTERBENCH_HUB_KEY", empty)
        assert hub_places([empty]) == ["https://a.example"]
        assert hub_places(["https://d.example", empty]) == ["https://d.example"]
        assert hub_key(empty) == "ab" * 32


def test_a_private_key_is_its_owners_and_never_overwritten(tmp_path):
    make_key(tmp_path / "key.pem")
    assert os.stat(tmp_path / "key.pem").st_mode & 0o777 == 0o600
    before = (tmp_path / "key.pem").read_bytes()
    with pytest.raises(HubError, match="it was left unchanged"):
        make_key(tmp_path / "key.pem")
    assert (tmp_path / "key.pem").read_bytes() == before
