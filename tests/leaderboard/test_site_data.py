"""The page of a data set: which boards are of its recipe. Files that a record has: made once, beside the server."""

from __future__ import annotations

import threading
from dataclasses import replace

import pytest

from oysterbench.recipe import load_split
from oysterbench.simulation.generate import digest
from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.site import render
from oysterbench_leaderboard.site.cache import Kept
from oysterbench_leaderboard.site.pages.data import split_page
from oysterbench_leaderboard.site.server import application
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import record_made
from tests.helpers.site_made import Client, make_site


@pytest.mark.parametrize("hidden", [True, False, None])
def test_records_say_whether_a_split_without_a_recipe_here_is_hidden(tmp_path, hidden):
    store = RecordStore(tmp_path / "board")
    made = record_made("carp", skill=0.5)
    store.add(replace(made, results=tuple(replace(one, split="pool-test", hidden=hidden) for one in made.results)))
    page = split_page(Site(open_index(store, str(tmp_path / "index.sqlite")), ()), "pool-test")
    assert page.data["hidden"] == bool(hidden)
    assert ("ground truth withheld" in render.page_html(page, render.server_links())) == bool(hidden)


def test_only_records_of_another_recipe_are_said_to_be_of_one(tmp_path):
    here = digest(load_split("slam-val"))
    for name, board_digest, other in (("here", here, False), ("there", "0" * 64, True)):
        store = RecordStore(tmp_path / name)
        made = record_made("carp", skill=0.5)
        store.add(replace(made, results=tuple(replace(one, split_digest=board_digest) for one in made.results)))
        page = split_page(Site(open_index(store, str(tmp_path / f"{name}.sqlite")), ()), "slam-val")
        assert ("other recipe" in render.page_html(page, render.server_links())) == other


def test_files_are_made_once_and_never_where_all_requests_are_served(tmp_path, monkeypatch):
    site, digests = make_site(tmp_path)
    client, threads, of = Client(application(site, fresh_s=60.0)), [], Kept.of

    def noted(body: bytes, media: str) -> Kept:
        threads.append(threading.get_ident())
        return of(body, media)

    monkeypatch.setattr(Kept, "of", noted)
    for address in ("curves.json", "record.json", "curves.json", "record.json"):
        assert client.get(f"/records/{digests['cod']}/{address}").status == 200
    assert [client.get("/static/style.css").status for _ in range(2)] == [200, 200]
    client.close()
    assert len(threads) == 3
    assert threading.get_ident() not in threads
