"""Folders of the machine are in no text of a published record; everything else in the texts stays."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from oysterbench.results.records import ResultRecord, write_results
from oysterbench_leaderboard.publishing.contradictions import CHECKS
from oysterbench_leaderboard.publishing.folders import folders_here, without_folders
from oysterbench_leaderboard.publishing.publish import Attribution, publish, records_of
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import record_made

TOPICS = ("/imu", "/cam_front/image", "/dvl/velocity", "/truth/pose")


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """Folder of results under the home folder of a user."""
    monkeypatch.setenv("HOME", str(tmp_path / "me"))
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path / "data"))
    return tmp_path / "me" / "My Docs"


def result(**values) -> ResultRecord:
    return ResultRecord(**{"track": "slam", "split": "s", "sequence": "dive", "method": "mine", **values})


def failure(text: str, folder: Path) -> str:
    told = without_folders(result(failure=text), folders_here(folder), TOPICS).failure
    assert told is not None
    return told


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("boom in (/home/me/a.cc:3), [/home/me/b], `/srv/x/c`", "boom in (a.cc:3), [b], `c`"),
        ("[Errno 2] No such file: '/home/me/My Docs/x y.tum'", "[Errno 2] No such file: 'x y.tum'"),
        ("read file:///home/me/x.tum, -I/home/me/include -O2", "read x.tum, -Iinclude -O2"),
        ("PATH=/home/me/a/bin:/opt/ros/lib", "PATH=bin:lib"),
        ("in ~/data/x.tum, ./run.sh and ../../me/y.tum", "in x.tum, run.sh and y.tum"),
        ("out/at/runs/mine/dive/1/trajectory.tum:3: no number", "trajectory.tum:3: no number"),
        ("OUT/x of topic /imu, HOME, HOME/y, HOME.", "x of topic /imu, FOLDER, y, FOLDER."),
        ("/tmp/x.tum is empty", "x.tum is empty"),
    ],
)
def test_folders_are_cut_wherever_they_stand(text, told, here, monkeypatch):
    monkeypatch.setattr("tempfile.gettempdir", lambda: "/tmp")
    text = text.replace("OUT", str(here)).replace("HOME", str(here.parent))
    assert failure(text, here) == told


def test_a_new_record_has_its_names_in_one_unicode_form(tmp_path):
    write_results(tmp_path / "results.json", record_made("c\u0327arp").results)
    ((record, _),) = records_of(tmp_path, Attribution("Te\u0301am", "baseline"))
    assert (record.method, record.team) == ("\u00e7arp", "T\u00e9am")
    for check in CHECKS:
        check(record)


@pytest.mark.parametrize(
    "text",
    [
        "1 / 2 of images of topic /cam_front/image, at 20 m/s, 3/4/5 of N/A",
        "no topic matches '/cam_front/*'; its topics: /imu, /dvl/velocity, /cam_left/camera_info",
        "see https://example.org/a/b/c?path=/d/e/f or http://localhost:80/a/b/c",
        "/cam_front/image/compressed/x is of topic /cam_front/image",
        "a relative path such as data/dives/x.tum",
    ],
)
def test_topics_fractions_and_addresses_stay(text, here):
    assert failure(text, here) == text


def test_every_text_of_a_result_is_cut_and_programs_are_told_by_their_names(here):
    program = here / "mine.sh"
    run = {
        "command": [str(program), "/tmp/in/x", f"--config={here}/rig.yaml"],
        "versions": {
            "oysterbench": "1.0",
            "program": str(program),
            f"sha256 of {program}": "ab",
            "sha256 of /home/me/b/mine.sh": "cd",
        },
        "limit_s": 60.0,
    }
    note = f"its online path was left out: {here}/runs/mine/dive/1/trajectory.online.tum: line 3"
    one = result(
        notes=(note,),
        reasons={"nees_position": "no covariance in /home/me/x.npz"},
        metrics={"nees_position": float("nan")},
        info={"run": run, "method": {"code": "/home/me/code"}},
        method_settings={"command": f"'{program}' {{tum}} {{out}}"},
    )
    told = without_folders(one)
    assert told.info["run"]["versions"] == {
        "oysterbench": "1.0",
        "program": "mine.sh",
        "sha256 of mine.sh": "ab",
        "sha256 of mine.sh (2)": "cd",
    }
    assert told.info["run"]["command"] == ["mine.sh", "x", "--config=rig.yaml"]
    assert told.info["run"]["limit_s"] == 60.0
    assert told.notes == ("its online path was left out: trajectory.online.tum: line 3",)
    assert told.method_settings == {"command": "'mine.sh' {tum} {out}"}
    text = json.dumps(told.to_dict())
    assert [word for word in ("home", "My Docs", "/me", str(here)) if word in text] == []
    assert without_folders(told) == told


def test_a_record_of_a_split_has_no_folder_and_all_of_its_topics(here, tmp_path):
    first = record_made().results[0]
    told = "no topic matches /cam_left/image in "
    run = {"command": [f"{here}/mine.sh"], "versions": {"program": f"{here}/mine.sh"}}
    folder = here / "results"
    folder.mkdir(parents=True)
    ones = [ResultRecord.from_dict({**first.to_dict(), "failure": f"{told}{folder}/x", "info": {"run": run}})]
    write_results(folder / "results.json", ones)
    store = RecordStore(tmp_path / "board")
    ((record, digest, _),) = publish(store, records_of(folder, Attribution("x", "baseline")))
    assert record.results[0].failure == f"{told}x"
    assert str(tmp_path) not in (text := store.record(digest).data.decode())
    assert "mine.sh" in text
