"""What a server of submissions is told at its start: its settings, its folders, and whether it can read at all."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.storage.store import RecordStore
from oysterbench_leaderboard.submissions.accounts.tokens import issue
from oysterbench_leaderboard.submissions.estimates import upload_of
from oysterbench_leaderboard.submissions.sandbox import namespaces
from oysterbench_leaderboard.submissions.settings import load_settings
from oysterbench_leaderboard.submissions.web import open_service
from oysterbench_leaderboard.submissions.words import Form
from tests.helpers.pool import answers, lay_split
from tests.helpers.served import drain, make_service


def test_settings_come_from_the_private_folder(tmp_path):
    (tmp_path / "settings.toml").write_text("per_day = 3\nworkers = 5\n")
    assert load_settings(tmp_path).per_day == 3
    wrong = {
        "per_dya = 3": "unknown field `per_dya`; known keys: database",
        "per_day = 'x'": "Expected `int`, got `str`",
        "per_day = 0": ">= 1",
    }
    for text, message in wrong.items():
        (tmp_path / "settings.toml").write_text(text)
        with pytest.raises(ResultError, match=message):
            load_settings(tmp_path)


def test_folders_may_be_given_as_seen_from_here(tmp_path, monkeypatch):
    for name, hidden in (("pool-test", True), ("pool-val", False)):
        lay_split(tmp_path / "splits", name, hidden=hidden)
    monkeypatch.chdir(tmp_path)
    truths = [f"splits/{name}.toml=splits/{name}-truth" for name in ("pool-test", "pool-val")]
    service = open_service(Path("private"), truths, RecordStore(Path("board")))
    try:
        issue(service.database, "reef lab")
        file = service.incoming / "sent"
        file.write_bytes(answers(tmp_path, 0))
        made, _ = service.submit("reef lab", Form("carp", "pool-test"), upload_of(file))
        drain(service)
        assert service.get("reef lab", made.id).state == "done"
    finally:
        service.close()


def test_a_private_folder_within_what_is_public_is_refused(tmp_path, monkeypatch):
    (tmp_path / "hub" / "manifests").mkdir(parents=True)
    (tmp_path / "hub" / "index.json").write_text("{}")
    (tmp_path / "board").mkdir()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to("board", target_is_directory=True)
    for private, public in (("board", "board"), ("link/private", "board"), ("hub", "hub"), ("hub/a/b", "hub")):
        with pytest.raises(
            ResultError, match=rf"^--submissions {private}: expected a folder outside the .*{public}, wh"
        ):
            open_service(Path(private), [], RecordStore(Path("board")))
    assert list((tmp_path / "board").iterdir()) == []


def test_a_server_that_cannot_read_uploads_does_not_start(tmp_path):
    lay_split(tmp_path / "splits", "pool-test")
    service = make_service(tmp_path, check_wall_s=1e-3)
    try:
        with pytest.raises(ResultError, match=r"uploads cannot be read here.*private\.log there says why"):
            service.self_test()
    finally:
        service.close()


def test_a_server_that_needs_namespaces_does_not_start_without(tmp_path, monkeypatch):
    lay_split(tmp_path / "splits")
    monkeypatch.setattr(namespaces, "missing", lambda: "no bubblewrap swims here")
    with closing(make_service(tmp_path)) as service:
        service.self_test()
        assert "no bubblewrap swims here" in (tmp_path / "private" / "private.log").read_text()
    with (
        closing(make_service(tmp_path, needs_namespaces=True)) as service,
        pytest.raises(ResultError, match=r"needs_namespaces of settings\.toml .* no bubblewrap swims here"),
    ):
        service.self_test()
