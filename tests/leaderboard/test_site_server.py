"""The site over HTTP, and as files."""

from __future__ import annotations

import asyncio
import gzip
import re
import shutil
from dataclasses import replace
from pathlib import Path
from posixpath import dirname, normpath
from typing import Any
from urllib.parse import unquote

import pytest
from click.testing import CliRunner

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.site import running
from oysterbench_leaderboard.site.cache import Kept, PageCache
from oysterbench_leaderboard.site.command import build_command, serve_command
from oysterbench_leaderboard.site.export import export
from oysterbench_leaderboard.site.links import FileLinks
from oysterbench_leaderboard.site.openapi import describe
from oysterbench_leaderboard.site.pages import board as board_pages
from oysterbench_leaderboard.site.paths import method_path
from oysterbench_leaderboard.site.render import page_html
from oysterbench_leaderboard.site.running import Watch
from oysterbench_leaderboard.site.server import SECURITY, application
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import NASTY, record_made
from tests.helpers.site_made import Client, Reading, crawl, make_site

BOARD = "/boards/slam/slam-val"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_site(tmp_path_factory.mktemp("board"))


@pytest.fixture(scope="module")
def client(made):
    found = Client(application(made[0], fresh_s=0.0))
    yield found
    found.close()


@pytest.fixture(scope="module")
def digests(made):
    return made[1]


@pytest.fixture(scope="module")
def exported(made, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("export") / "site"
    export(made[0], folder)
    return folder


@pytest.mark.parametrize("alike", [4, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_every_link_of_the_site_leads_somewhere_and_every_answer_is_secured(client, alike):
    seen = crawl(client, alike)
    assert len(seen) > 100
    for address, answer in seen.items():
        assert answer.status == 200, address
        for name, value in SECURITY.items():
            assert answer.headers[name.decode()] == value.decode(), address
    assert "'unsafe" not in SECURITY[b"content-security-policy"].decode()
    kinds = {answer.headers["content-type"].partition(";")[0] for answer in seen.values()}
    assert kinds >= {"text/html", "application/json", "text/csv", "application/x-tex", "text/css", "text/javascript"}


@pytest.mark.parametrize(
    "address",
    [
        "/nothing",
        "/records/abcdefgh",
        "/records/1234",
        f"/records/{'0' * 64}",
        "/records/../../etc/passwd",
        "/records/%2e%2e%2f%2e%2e%2fetc%2fpasswd",
        "/static/../records",
        "/static/..%2f..%2fpage.py",
        "/boards/slam/slam-val/0123456789abcdef",
        "/boards/SLAM/slam-val",
        "/methods/whale",
        "/data/nowhere",
    ],
)
def test_what_is_not_there_is_told_with_what_to_do(client, address):
    answer = client.get(address)
    assert answer.status == 404
    assert answer.headers["content-security-policy"]
    read = Reading(answer.text)
    assert len([link for link in read.links() if link in ("/", "/data", BOARD)]) >= 1
    assert "Traceback" not in answer.text
    assert "root:" not in answer.text


def test_representations_of_what_is_not_there_say_so_in_their_own_form(client):
    answer = client.get("/methods/whale.json")
    assert answer.status == 404
    assert answer.json()["error"] == "no record of a method 'whale'"
    assert client.get("/methods/whale.csv").headers["content-type"].startswith("text/plain")
    assert client.get(f"{BOARD}.json?sort=beauty").status == 400
    assert client.get("/compare.json?a=carp&b=").status == 400
    assert client.get(BOARD, "POST").status == 405


def test_a_failure_inside_is_not_shown(made):
    site = made[0]

    class Broken:
        store = site.store
        revision = "1"

        def boards(self, track=None):
            raise RuntimeError("a secret of the machine /root/key")

    client = Client(application(replace(site, index=Broken()), fresh_s=0.0))
    answer = client.get("/")
    client.close()
    assert answer.status == 500
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert "secret" not in answer.text
    assert "Traceback" not in answer.text
    assert "could not be generated" in answer.text


def test_a_damaged_record_is_told_of_without_the_name_of_its_file(tmp_path, caplog):
    site, digests = make_site(tmp_path)
    (tmp_path / "records" / f"{digests['cod']}.json").write_text("{}")
    client = Client(application(site, fresh_s=0.0))
    answers = [client.get(f"/records/{digests['cod']}{rest}") for rest in ("", ".json", "/record.json")]
    log = client.get("/log")
    client.close()
    assert {answer.status for answer in answers} == {500}
    assert not any(str(tmp_path) in answer.text for answer in answers)
    assert "it was changed, and was not used" in caplog.text
    assert log.status == 200


def test_a_short_digest_leads_to_the_whole_one(client, digests):
    answer = client.get(f"/records/{digests['cod'][:8]}.csv")
    assert answer.status == 302
    assert answer.headers["location"] == f"/records/{digests['cod']}.csv"


def test_the_record_itself_is_given_byte_for_byte(client, made, digests):
    site = made[0]
    assert client.get(f"/records/{digests['cod']}/record.json").body == site.store.data(digests["cod"])
    assert client.get(f"/records/{digests['cod']}/curves.json").json()["format"] == "oysterbench-curves/1"
    assert client.get(f"/records/{digests['drift']}/curves.json").status == 404


def test_two_ticked_records_are_compared(client, digests):
    answer = client.get(f"/compare?r={digests['cod']}&r={digests['carp2']}")
    assert answer.status == 200
    assert "<h1>cod against carp</h1>" in answer.text
    assert client.get(f"/compare?r={digests['cod']}").status == 400


def test_pages_are_compressed_and_not_sent_twice(client):
    plain = client.get(BOARD)
    small = client.get(BOARD, accept_encoding="br, gzip;q=0.8")
    assert small.headers["content-encoding"] == "gzip"
    assert gzip.decompress(small.body) == plain.body
    assert small.headers["etag"] != plain.headers["etag"]
    assert small.headers["vary"] == "Accept-Encoding"
    assert "content-encoding" not in client.get(BOARD, accept_encoding="gzip;q=0").headers
    for answer, accepted in ((plain, "identity"), (small, "gzip")):
        again = client.get(BOARD, accept_encoding=accepted, if_none_match=f'W/"x", {answer.headers["etag"]}')
        assert (again.status, again.body) == (304, b"")
    assert client.get(BOARD, if_none_match='"x"').status == 200


def test_a_new_record_is_shown_and_an_old_page_is_not(tmp_path):
    site, _ = make_site(tmp_path)
    client, watch = Client(application(site, fresh_s=0.0)), Watch(site.index)
    before = client.get(BOARD)
    assert not watch.look()
    site.store.add(record_made("turbot", skill=0.95))
    assert "turbot" not in client.get(BOARD).text
    assert watch.look()
    after = client.get(BOARD, if_none_match=before.headers["etag"])
    client.close()
    assert after.status == 200
    assert "turbot" in after.text


def test_new_records_are_looked_for_again_after_any_failure(made, monkeypatch):
    faults = iter([RuntimeError("a fault of ours"), RuntimeError("another"), SystemExit()])  # the last ends the task

    def look(watch: Watch) -> bool:
        raise next(faults)

    monkeypatch.setattr(running, "LOOK_S", 0.0)
    monkeypatch.setattr(Watch, "look", look)
    with pytest.raises(SystemExit):
        asyncio.run(running._keep_up(made[0].index))
    assert next(faults, None) is None


def test_many_who_ask_at_once_wait_for_one_making(made):
    site, asked = made[0], []

    class Counting:
        store = site.store

        def __getattr__(self, name):
            if name == "page":
                asked.append(name)
            return getattr(site.index, name)

    client = Client(application(replace(site, index=Counting()), fresh_s=60.0))

    async def all_at_once():
        return await asyncio.gather(*(client.ask(f"{BOARD}?q=o") for _ in range(20)))

    answers = client.loop.run_until_complete(all_at_once())
    client.close()
    assert len({answer.body for answer in answers}) == 1
    assert 1 <= len(asked) <= 2  # the page, and perhaps the row behind it


def test_kept_pages_are_bounded_and_of_one_revision():
    cache = PageCache(10_000)
    for i in range(100):
        cache.get("1", "other")
        cache.put("1", i, Kept.of(bytes(700), "text/html"))
        assert cache.bytes <= 10_000
    assert 2 < len(cache) < 15
    assert cache.get("1", 99) is not None
    assert cache.get("1", 0) is None
    assert cache.get("2", 99) is None
    assert (len(cache), cache.bytes) == (0, 0)
    cache.put("1", 99, Kept.of(b"late", "text/html"))
    assert cache.get("2", 99) is None


# The description:


def fits(value, schema, schemas) -> bool:
    """Whether a value is of a schema, as far as ours go."""
    if "$ref" in schema:
        return fits(value, schemas[schema["$ref"].rpartition("/")[2]], schemas)
    if "anyOf" in schema:
        return any(fits(value, one, schemas) for one in schema["anyOf"])
    if "enum" in schema and value not in schema["enum"]:
        return False
    kinds: dict[str, Any] = {"string": str, "integer": int, "number": (int, float), "boolean": bool, "null": type(None)}
    kind = schema.get("type")
    if kind == "array":
        return isinstance(value, list) and all(fits(one, schema.get("items", {}), schemas) for one in value)
    if kind == "object":
        properties, others = schema.get("properties", {}), schema.get("additionalProperties", {})
        return (
            isinstance(value, dict)
            and set(schema.get("required", ())) <= value.keys()
            and all(fits(one, properties.get(key, others), schemas) for key, one in value.items())
        )
    return kind is None or (isinstance(value, kinds[kind]) and (kind == "boolean" or not isinstance(value, bool)))


def test_every_address_is_described_and_every_answer_is_as_described(client, digests):
    document = client.get("/openapi.json").json()
    assert document["openapi"].startswith("3.1.")
    assert {"title", "version"} <= document["info"].keys()
    served = {re.sub(r":\w+", "", route.path) for route in client.app.routes}
    described = set(document["paths"])
    assert served - described == {"/static/{name}", "/robots.txt"}
    assert described <= served
    names = set()
    schemas = document["components"]["schemas"]
    for path, item in document["paths"].items():
        operation = item["get"]
        names.add(operation["operationId"])
        assert operation["summary"]
        assert {part["name"] for part in operation["parameters"] if part["in"] == "path"} == set(
            re.findall(r"\{(\w+)\}", path)
        )
        assert all({"name", "in", "schema", "description"} <= part.keys() for part in operation["parameters"])
        assert all({"description"} <= answer.keys() for answer in operation["responses"].values())
        given = {"track": "slam", "split": "slam-val", "method": "carp", "digest": digests["carp2"]}
        given["board"] = client.get(f"{BOARD}.json").json()["board"]["id"]
        answer = client.get(path.format(**given) + ("?a=carp&b=cod" if path.startswith("/compare") else ""))
        media, content = next(iter(operation["responses"]["200"]["content"].items()))
        assert answer.headers["content-type"].partition(";")[0] == media, path
        if media == "application/json":
            assert fits(answer.json(), content["schema"], schemas), path
    assert len(names) == len(document["paths"])
    refs = set(re.findall(r'"#/components/schemas/(\w+)"', client.get("/openapi.json").text))
    assert refs <= schemas.keys()


def test_the_description_of_files_asks_nothing_of_a_server():
    document = describe(static=True)
    assert all(part["in"] == "path" for item in document["paths"].values() for part in item["get"]["parameters"])
    assert "/compare" not in document["paths"]


# As files:


@pytest.mark.slow
def test_every_link_of_the_files_leads_to_a_file_of_them(exported):
    there = {str(path.relative_to(exported)) for path in exported.rglob("*") if path.is_file()}
    pages = [name for name in there if name.endswith(".html")]
    assert len(pages) > 40
    for name in pages:
        read = Reading((exported / name).read_text())
        assert not read.wrong, name
        assert not read.all("form"), name
        for link in read.links():
            if link.startswith(("https://", "http://", "#")):
                continue
            assert not link.startswith("/"), (name, link)
            assert normpath(f"{dirname(name)}/{unquote(link)}").lstrip("/") in there, (name, link)
    for method, _ in NASTY:
        assert f"{method_path(method)[1:]}/index.html" in there
    assert sum(name.startswith("compare/") and name.endswith(".html") for name in there) > 20


def test_files_say_which_pairs_they_have_and_what_to_type_for_others(made, exported, client, digests, monkeypatch):
    board = Reading((exported / "boards/slam/slam-val/index.html").read_text()).text
    assert "Every two records have a head-to-head page; in a terminal, oysterbench compare A B" in board
    record = Reading((exported / "records" / digests["cod"] / "index.html").read_text()).text
    assert f"oysterbench compare {digests['cod'][:8]} B --split slam-val compares any two" in record
    assert "oysterbench compare" not in client.get(BOARD).text
    monkeypatch.setattr(board_pages, "PAIRED", 3)
    page = board_pages.board_page(made[0], "slam", "slam-val")
    shown_text = Reading(page_html(page, FileLinks(page.path, set()))).text
    assert "Only the first 3 records have head-to-head pages; in a terminal" in shown_text


def test_files_say_what_the_server_says(exported, client, digests):
    for name, address in (("boards/slam/slam-val", BOARD), (f"records/{digests['cod']}", f"/records/{digests['cod']}")):
        assert (exported / f"{name}.csv").read_text() == client.get(f"{address}.csv").text
        assert (exported / f"{name}.tex").read_text() == client.get(f"{address}.tex").text
    record = exported / "records" / digests["cod"] / "record.json"
    assert record.read_bytes() == client.get(f"/records/{digests['cod']}/record.json").body


def test_the_same_records_give_the_same_files_and_leave_them_alone(made, exported, tmp_path):
    copy = tmp_path / "site"
    shutil.copytree(exported, copy)
    (copy / "about.json").write_text("{}")
    (copy / "stray.html").write_text("of an earlier site")
    before = {path.relative_to(copy): path.stat() for path in copy.rglob("*") if path.is_file()}
    export(made[0], copy)
    after = {path.relative_to(copy): path.stat() for path in copy.rglob("*") if path.is_file()}
    assert set(before) - set(after) == {Path("stray.html")}
    changed = {name for name, status in after.items() if status.st_ino != before[name].st_ino}
    assert changed == {Path("about.json")}
    for name in after:
        assert (copy / name).read_bytes() == (exported / name).read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["site"]


def test_a_folder_of_others_is_left_alone(made, tmp_path):
    (tmp_path / "thesis.tex").write_text("three years")
    with pytest.raises(ResultError, match="expected an empty folder"):
        export(made[0], tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_an_export_that_fails_leaves_the_old_one(made, exported, tmp_path):
    copy = tmp_path / "site"
    shutil.copytree(exported, copy)
    site = made[0]

    class Failing(type(site)):
        def status_changes(self, digest):
            raise ResultError("the disk is gone")

    with pytest.raises(ResultError, match="the disk is gone"):
        export(Failing(site.index), copy)
    assert (copy / "index.html").read_bytes() == (exported / "index.html").read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["site"]


def test_build_writes_the_board_that_it_is_told(tmp_path):
    store = RecordStore(tmp_path / "board")
    store.add(record_made("carp"))
    result = CliRunner().invoke(
        build_command, [str(tmp_path / "out"), "--board", str(store.folder), "--index", str(tmp_path / "index.sqlite")]
    )
    assert result.exit_code == 0, result.output
    assert "files; open" in result.output
    assert "carp" in (tmp_path / "out" / "index.html").read_text()


def test_serve_refuses_what_makes_no_sense():
    runner = CliRunner()
    assert "give --submissions as well" in runner.invoke(serve_command, ["--truth", "a=b"]).output
    assert "expected a path like /board" in runner.invoke(serve_command, ["--root", "board/"]).output
