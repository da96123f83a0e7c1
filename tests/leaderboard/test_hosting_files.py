"""What a board is hosted with says what is so: commands have their options, files are there."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from oysterbench_leaderboard.command import command
from oysterbench_leaderboard.commands.options import Place
from oysterbench_leaderboard.site.command import serve_command
from oysterbench_leaderboard.submissions.settings import load_settings
from tests.helpers.paths import ROOT

FOLDER = ROOT / "leaderboard" / "hosting"
COMPOSE = yaml.safe_load((FOLDER / "compose.yaml").read_text())


def serving(text):
    """Arguments of every `oysterbench leaderboard serve` in a file."""
    plain = re.sub(r"\\\n|[\[\]]|\",? ?\"?", " ", text)
    return [shlex.split(found) for found in re.findall(r"oysterbench +leaderboard +serve(.*)", plain)]


@pytest.mark.parametrize("name", ["oysterbench-board.service", "Containerfile"])
def test_the_server_is_started_with_options_that_it_has(name):
    started = serving((FOLDER / name).read_text())
    assert started
    for arguments in started:
        serve_command.make_context("serve", arguments)


def test_what_the_unit_lets_an_environment_file_set_is_set_by_no_option(monkeypatch):
    text = (FOLDER / "oysterbench-board.service").read_text()
    before, _, after = text.partition("EnvironmentFile=")
    named = re.findall(r"OYSTERBENCH_\w+", before.rpartition("[Service]")[2])
    assert named == ["OYSTERBENCH_BOARD", "OYSTERBENCH_INDEX"]
    for name in named:
        assert f"{name}=/srv/board" in after.partition("ExecStart=")[0], "a default, which the file overrides"
        monkeypatch.setenv(name, f"/elsewhere/{name}")
    seen = []
    monkeypatch.setattr("oysterbench.hub.connections.listen", lambda host, port: None)
    monkeypatch.setattr(Place, "index", lambda place: sys.exit(seen.append((str(place.path), place.url))))
    CliRunner().invoke(command, ["serve", *serving(text)[0]])
    assert seen == [("/elsewhere/OYSTERBENCH_BOARD", "/elsewhere/OYSTERBENCH_INDEX")]


def test_the_compose_file_mounts_what_is_there_and_starts_what_exists():
    serve_command.make_context("serve", serving(COMPOSE["services"]["site"]["command"])[0])
    for service in COMPOSE["services"].values():
        assert set(service.get("depends_on", ())) <= set(COMPOSE["services"])
        for mounted in service.get("volumes", ()):
            source = mounted.split(":")[0]
            known = (FOLDER / source).exists() or source in ("./truth", "./secrets") or source in COMPOSE["volumes"]
            assert known, source


def test_its_settings_are_settings(tmp_path):
    (tmp_path / "settings.toml").write_text((FOLDER / "settings.toml").read_text())
    settings = load_settings(tmp_path)
    assert settings.url.startswith("postgresql+psycopg://")
    assert settings.estimates.startswith("s3://board/")


def test_links_of_the_page_lead_somewhere():
    for link in re.findall(r"\]\(([^)]+)\)", (FOLDER / "README.md").read_text()):
        assert (FOLDER / Path(link)).exists(), link
