"""Damaged files: they are reported, and no page suffers but their own."""

from __future__ import annotations

from dataclasses import replace
from posixpath import dirname, normpath
from urllib.parse import unquote

import pytest
from click.testing import CliRunner

from oysterbench_leaderboard.boards.board import STATES, Query
from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.site import datasets
from oysterbench_leaderboard.site.command import build_command
from oysterbench_leaderboard.site.pages import home
from oysterbench_leaderboard.site.pages.board import board_page
from oysterbench_leaderboard.site.paths import board_path
from oysterbench_leaderboard.site.server import application
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import curves_made, record_made
from tests.helpers.site_made import Client, Reading, make_site
from tests.leaderboard.test_site_stress import stressed

STRAY = "a" * 64


@pytest.fixture(autouse=True)
def no_recipes(monkeypatch):
    """No split has a recipe here: loading all takes seconds."""
    for module in (datasets, home):
        monkeypatch.setattr(module, "known", dict)
    monkeypatch.setattr(home, "pictures", dict)


def damage(store, kind, digest):
    """Change a byte of a file."""
    path = store.folder / kind / f"{digest}.json"
    path.write_bytes(path.read_bytes().replace(b"oyster", b"oyfter", 1))


def test_no_page_suffers_from_files_of_others(tmp_path):
    site, digests = make_site(tmp_path)
    boards = [info.id for info in site.index.boards()]
    damaged = {site.index.page(board, Query(states=STATES)).rows[0].digest for board in boards} | {digests["carp2"]}
    for digest in damaged:
        damage(site.store, "records", digest)
    (tmp_path / "changes" / f"{STRAY}.json").write_text("{")
    site.index.refresh()
    addresses = ["/", "/data", "/data/slam-val", "/log", *(board_path(info) for info in site.index.boards())]
    addresses += [f"/records/{digest}.json" for digest in sorted(damaged | {digests["carp1"], digests["straight"]})]
    addresses += [f"/methods/{name}.json" for name in ("carp", "cod", "unet", "boxes", "straight")]
    client = Client(application(site, fresh_s=0.0))
    seen = {address: client.get(address) for address in addresses}
    client.close()
    assert {digests["unet"], digests["boxes"]} < damaged
    failed = {address for address, answer in seen.items() if answer.status != 200}
    assert failed == {f"/records/{digest}.json" for digest in damaged}
    assert STRAY in seen["/log"].text
    assert "clear" in seen["/data/slam-val"].text


def test_a_board_of_disturbances_is_drawn_without_damaged_records(tmp_path):
    store = RecordStore(tmp_path / "board")
    digest, _ = (store.add(stressed(method, skill)) for method, skill in (("carp", 0.8), ("cod", 0.4)))
    index = open_index(store, str(tmp_path / "index.sqlite"))
    damage(store, "records", digest)
    (drawing,) = board_page(Site(index), "slam", "slam-val").context["drawings"]
    assert "cod" in drawing.legend
    assert "carp" not in drawing.legend


def test_build_goes_on_without_damaged_files_and_reports_them(tmp_path):
    store = RecordStore(tmp_path / "board")
    made = record_made("carp", skill=0.8)
    lost = replace(record_made("cod", skill=0.7), curves=store.add_curves(curves_made("cod", 0.7)))
    bad, good, _ = (store.add(record) for record in (made, lost, record_made("eel", skill=0.5)))
    store.change_status(bad, "withdrawn", "A test.")
    store.change_status(bad, "restored", "A test.")
    open_index(store, str(tmp_path / "index.sqlite")).close()
    damage(store, "records", bad)
    damage(store, "curves", lost.curves)
    (store.folder / "changes" / f"{STRAY}.json").write_text("{")
    place = ["--board", str(store.folder), "--index", str(tmp_path / "index.sqlite")]
    result = CliRunner().invoke(build_command, [str(tmp_path / "out"), *place])
    assert result.exit_code == 0, result.output
    lines = sorted(line for line in result.output.splitlines() if line.startswith("left out: "))
    assert [line.split(": ")[1] for line in lines] == sorted([STRAY[:12], bad[:12], lost.curves[:12]])
    assert all("its bytes do not match its name" in line for line in lines)
    there = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert f"records/{good}/index.html" in there
    assert not any(bad[:16] in name or name.endswith("curves.json") for name in there)
    for name in there:
        if name.endswith(".html"):
            links = [link for link in Reading((tmp_path / "out" / name).read_text()).links() if ":" not in link]
            files = {normpath(f"{dirname(name)}/{unquote(link)}").lstrip("/") for link in links if link[0] != "#"}
            assert files <= there, name


@pytest.mark.parametrize("kind", ["records", "changes"])
def test_a_file_that_cannot_be_read_is_left_out(tmp_path, kind):
    store = RecordStore(tmp_path / "board")
    store.add(record_made("carp"))
    (store.folder / kind / f"{STRAY}.json").mkdir(parents=True)
    index = open_index(store, str(tmp_path / "index.sqlite"))
    assert [info.entries for info in index.boards()] == [1]
    assert "Is a directory" in index.problems()[STRAY]
