"""Sources of a tree: addresses and proxies that cannot be used are refused in one line."""

from __future__ import annotations

import pytest

from oysterbench.core.errors import HubError
from oysterbench.hub.pool import open_pool
from oysterbench.hub.sources import Patience, Refusal, Setback, Silence, open_source
from oysterbench_leaderboard.submissions.sending.client import Client
from tests.helpers.web import misbehaving


@pytest.mark.parametrize(
    "address", ["http://[::1", "http://", "https://host:port/tree", "http://host:0", "http://[x]/"]
)
def test_an_address_without_a_host_is_refused(address):
    with pytest.raises(HubError, match=r"expected the address of a hub, such as http://HOST:8000"):
        open_source(address)
    with pytest.raises(HubError, match="--to: expected the address of a leaderboard"):
        Client(address)


@pytest.mark.parametrize("proxy", ["127.0.0.1:3128", "http://127.0.0.1:3128", "user:word@127.0.0.1:3128"])
def test_a_proxy_is_taken_with_and_without_a_scheme(proxy, monkeypatch):
    monkeypatch.setenv("http_proxy", proxy)
    monkeypatch.delenv("no_proxy", raising=False)
    pool = open_pool("http://hub.example/tree", 1, Patience())
    assert (pool.proxy.scheme, pool.proxy.host, pool.proxy.port) == ("http", "127.0.0.1", 3128)


@pytest.mark.parametrize("proxy", ["socks5://user:word@127.0.0.1:1080", "http://user:word@[::1", "user:word@host:port"])
def test_a_proxy_that_cannot_be_used_is_named_by_its_variable_without_its_password(proxy, monkeypatch):
    monkeypatch.setenv("https_proxy", proxy)
    monkeypatch.delenv("no_proxy", raising=False)
    with pytest.raises(HubError, match=r"^https_proxy: expected the address of an HTTP proxy, such as ") as refused:
        open_pool("https://hub.example", 1, Patience())
    assert "word" not in str(refused.value)


@pytest.mark.parametrize("address", ["http://hub.invalid", "https://hub.invalid"])
def test_behind_a_proxy_that_is_down_no_server_is_reached(address, monkeypatch):
    """Unlike behind one that answers, though it be with an error. It is named, without its password."""
    monkeypatch.delenv("no_proxy", raising=False)

    def failed(proxy):
        for scheme in ("http", "https"):
            monkeypatch.setenv(f"{scheme}_proxy", proxy)
        with pytest.raises((Setback, Refusal)) as failure, open_source(address).open("index.json"):
            pass
        return failure.value

    down = failed("http://user:word@127.0.0.1:9")
    assert isinstance(down, Silence)
    assert str(down) == "no answer through the proxy 127.0.0.1:9: Connection refused"
    with misbehaving("unavailable", {"index.json": b"{}"}, 1, 1.0) as answering:
        assert not isinstance(failed(answering.url), Silence)
