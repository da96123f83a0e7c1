"""Pages are made once, however they are asked for, and for one client after the other."""

from __future__ import annotations

import asyncio
import threading
from itertools import permutations

import pytest

from oysterbench_leaderboard.site import routes
from oysterbench_leaderboard.site.cache import Kept
from oysterbench_leaderboard.site.pages.board import parse_query
from oysterbench_leaderboard.site.server import MAKERS, Pages, application
from tests.helpers.site_made import Client, make_site
from tests.helpers.waiting import PATIENCE_S


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_site(tmp_path_factory.mktemp("board"))


@pytest.fixture
def client(made):
    found = Client(application(made[0], fresh_s=0.0))
    yield found
    found.close()


def test_the_same_records_are_compared_once_however_they_are_named(made, client, monkeypatch):
    asked = []

    def several_page(site, names):
        asked.append(names)
        return original(site, names)

    original = routes.several_page
    monkeypatch.setattr(routes, "several_page", several_page)
    digests = [made[1][name] for name in ("cod", "carp2", "drift")]
    named = [*permutations(digests), [name[:8] for name in digests], [*digests, digests[0][:20]]]
    named.append([digests[0], "carp", digests[2]])
    answers = [client.get("/compare?" + "&".join(f"r={name}" for name in names)) for names in named]
    assert [answer.status for answer in answers] == [200] * len(named)
    assert len({answer.body for answer in answers}) == len(asked) == 1


def test_one_record_twice_and_another_are_two(made, client):
    cod, carp = made[1]["cod"], made[1]["carp2"]
    answer = client.get(f"/compare?r={cod}&r={carp}&r={cod[:8]}")
    assert answer.text == client.get(f"/compare?a={carp}&b={cod}").text


def test_pages_have_few_numbers_of_rows():
    assert len({parse_query({"size": [str(size)]}) for size in range(1, 1001)}) == 10


def test_however_many_pages_a_client_asks_for_the_next_is_made_for_another(made):
    pages, begun, ended = Pages(made[0], fresh_s=60.0), [], threading.Event()

    def make(name):
        def page() -> Kept:
            begun.append(name)
            ended.wait(0 if name == "other" else PATIENCE_S)
            return Kept.of(str(name).encode(), "text/plain")

        return page

    async def asked():
        names = [*range(2 * MAKERS), "other"]
        of_one = [asyncio.create_task(pages.made("one", name, make(name))) for name in names]
        while not begun:
            await asyncio.sleep(0.001)
        # Also where the other client waits for what the first one asked for, too.
        assert (await pages.made("another", "other", make("other"))).body == b"other"
        assert begun == [0, "other"]
        ended.set()
        await asyncio.gather(*of_one)
        assert sorted(map(str, begun)) == sorted(map(str, names))

    asyncio.run(asked())


def test_a_comparison_that_is_kept_does_not_wait_for_a_page_in_the_making(made):
    pages, begun, ended = Pages(made[0], fresh_s=60.0), threading.Event(), threading.Event()
    (compare,) = (route for route in routes.ROUTES if route.path == "/compare")
    query = compare.ask({"a": [made[1]["cod"][:9]], "b": ["carp"]})

    def make() -> Kept:
        begun.set()
        ended.wait(PATIENCE_S)
        return Kept.of(b"slow", "text/plain")

    async def asked():
        first = await pages.get("one", compare, {}, query, ".json")
        slow = asyncio.create_task(pages.made("one", "slow", make))
        while not begun.is_set():
            await asyncio.sleep(0.001)
        again = await asyncio.wait_for(pages.get("one", compare, {}, query, ".json"), PATIENCE_S / 2)
        assert not slow.done()
        ended.set()
        await slow
        return first, again

    first, again = asyncio.run(asked())
    assert first is again
