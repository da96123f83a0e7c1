"""A new evaluator over kept estimates: appended, in place of the old record, with what changed."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from click.testing import CliRunner

from oysterbench.cli.main import main
from oysterbench.core.trajectory import write_tum
from oysterbench.hub.canonical import sha256
from oysterbench.results.records import ResultRecord, write_results
from oysterbench_leaderboard.publishing.publish import Attribution, keep_estimates, records_of
from oysterbench_leaderboard.publishing.rescoring import score_again
from oysterbench_leaderboard.storage.record import Record
from oysterbench_leaderboard.storage.store import RecordStore
from oysterbench_leaderboard.submissions.sandbox import sandbox
from tests.helpers.pool import answers, lay_split
from tests.helpers.records_made import records_made
from tests.leaderboard.test_curves import loop, moved, results_of


def test_kept_paths_are_scored_again_into_a_record_in_place_of_the_old_one(tmp_path, monkeypatch):
    truth = loop()
    estimate = moved(truth, np.ones(3))
    write_tum(tmp_path / "mini-01-wave.tum", estimate)
    write_tum(tmp_path / "mini-01-truth.tum", truth)
    old_result = results_of(truth, estimate, evaluator="slam 2")
    write_results(tmp_path / "results.json", [old_result])
    ((old, _),) = records_of(tmp_path, Attribution("x", "baseline"))
    old = keep_estimates(old, tmp_path, tmp_path / "estimates")
    monkeypatch.setattr("oysterbench_leaderboard.publishing.rescoring._truths", lambda *_: {"mini-01": truth})
    done = score_again(old, tmp_path / "estimates", None, "A new evaluator.")
    assert done.record is not None, done.why
    (result,) = done.record.results
    assert (done.record.supersedes, done.record.reason) == (old.digest, "A new evaluator.")
    assert result.evaluator_version == "slam 3"
    assert result.metrics["wall_s"] == 3.0
    assert abs(result.metrics["score"] - old_result.metrics["score"]) < 1e-6
    (name,) = old.estimates.values()
    (tmp_path / "estimates" / name).write_text("changed")
    assert "it was changed" in score_again(old, tmp_path / "estimates", None, "x").why
    (tmp_path / "estimates" / name).unlink()
    assert "is not in" in score_again(old, tmp_path / "estimates", None, "x").why


def uploaded(folder: Path, recipe: Path) -> Record:
    """What a team sent, as an earlier evaluator is said to have scored it."""
    from oysterbench.evaluate.slam.settings import SlamSettings
    from oysterbench.recipe import load_split
    from oysterbench.simulation.generate import digest

    folder.mkdir(exist_ok=True)
    data = answers(folder)
    (folder / "estimates").mkdir()
    (folder / "estimates" / sha256(data)).write_bytes(data)
    results = [
        ResultRecord(
            track="slam",
            split="pool-test",
            split_digest=digest(load_split(str(recipe))),
            sequence=name,
            method="carp",
            metrics={"score": 0.125, "coverage": 1.0},
            settings=SlamSettings().as_dict(),
            evaluator_version="slam 1",
            created="2026-01-01T00:00:00Z",
        )
        for name in ("pool-01", "pool-02")
    ]
    return Record(
        method="carp",
        team="reef lab",
        tier="scored",
        results=tuple(results),
        estimates={f"{result.sequence}/1": sha256(data) for result in results},
        created="2026-01-01T00:00:00Z",
    )


def test_uploads_are_scored_again_within_the_limits_that_their_server_sets(tmp_path, here):
    recipe, truth = lay_split(tmp_path / "splits")
    old = uploaded(tmp_path, recipe)
    (tmp_path / "settings.toml").write_text("lines = 10\n")
    assert "expected at most 10" in score_again(old, tmp_path / "estimates", truth, "x", str(recipe)).why
    (tmp_path / "settings.toml").unlink()
    assert score_again(old, tmp_path / "estimates", truth, "x", str(recipe)).record is not None


def hidden_from(monkeypatch, old, estimates, truth, recipe, server=None):
    """Folders that the process which reads an upload cannot open."""
    jobs = []

    def run(job, allowance):
        jobs.append(job)
        return sandbox.Ended(None, "crash", "")

    monkeypatch.setattr(sandbox, "run", run)
    score_again(old, estimates, truth, "x", str(recipe), server)
    return [Path(folder) for folder in jobs[0].hidden]


def test_who_reads_an_upload_again_can_open_neither_the_private_folder_nor_the_truth(tmp_path, monkeypatch):
    recipe, truth = lay_split(tmp_path / "splits")
    private = tmp_path / "private"
    old = uploaded(private, recipe)
    estimates = private / "estimates"
    assert hidden_from(monkeypatch, old, estimates, truth, recipe) == [estimates, truth], (
        "a copy: its folder is no server's"
    )
    (private / "key").write_bytes(b"secret")
    assert hidden_from(monkeypatch, old, estimates, truth, recipe) == [private, estimates, truth]
    (private / "key").rename(tmp_path / "key")
    assert hidden_from(monkeypatch, old, estimates, truth, recipe, tmp_path) == [tmp_path, estimates, truth]
    assert score_again(old, estimates, truth, "x", str(recipe), tmp_path).why.endswith("an answer (crash)")
    (tmp_path / "settings.toml").write_text("lines = 'many'")
    assert "known keys" in score_again(old, estimates, truth, "x", str(recipe), tmp_path).why


def test_the_folder_of_a_server_elsewhere_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_BOARD", str(tmp_path / "board"))
    recipe, truth = lay_split(tmp_path / "splits")
    RecordStore(tmp_path / "board").add(uploaded(tmp_path / "data", recipe))
    server = tmp_path / "server"
    server.mkdir()
    (server / "settings.toml").write_text("lines = 10\n")
    words = ["leaderboard", "rescore", "--estimates", str(tmp_path / "data" / "estimates"), "--dry-run"]
    words += ["--split", str(recipe), "--truth", str(truth)]
    monkeypatch.setattr(sandbox, "run", lambda job, allowance: sandbox.Ended(None, str(job.limits.lines), ""))
    for more, environment in ((["--submissions", str(server)], {}), ([], {"OYSTERBENCH_SUBMISSIONS": str(server)})):
        asked = CliRunner().invoke(main, [*words, *more], env=environment)
        assert "ended without an answer (10)" in asked.stderr


def test_a_folder_that_is_no_servers_is_not_taken_for_one(tmp_path, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_BOARD", str(tmp_path / "board"))
    recipe, truth = lay_split(tmp_path / "splits")
    RecordStore(tmp_path / "board").add(uploaded(tmp_path / "data", recipe))
    (tmp_path / "empty").mkdir()
    words = ["leaderboard", "rescore", "--estimates", str(tmp_path / "data" / "estimates"), "--dry-run"]
    words += ["--split", str(recipe), "--truth", str(truth)]
    asked = CliRunner().invoke(main, [*words, "--submissions", str(tmp_path / "empty")])
    assert (asked.exit_code, "empty: expected the private folder of a server" in asked.stderr) == (1, True)
    monkeypatch.setattr(sandbox, "run", lambda job, allowance: sandbox.Ended(None, "crash", ""))
    asked = CliRunner().invoke(main, words)
    assert "is in no server's folder: uploads are read within the default limits" in asked.stderr


def board_of_one(tmp_path, monkeypatch):
    """A board with a record of an upload, the record, and the command that scores it again."""
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("OYSTERBENCH_BOARD", str(tmp_path / "board"))
    recipe, truth = lay_split(tmp_path / "splits")
    store, old = RecordStore(tmp_path / "board"), uploaded(tmp_path, recipe)
    (tmp_path / "key").write_bytes(b"secret")  # so that all around the upload is hidden from the process that reads it
    store.add(old)
    words = ["leaderboard", "rescore", "--estimates", str(tmp_path / "estimates"), "--json"]
    return store, old, [*words, "--split", str(recipe), "--truth", str(truth)]


def test_uploads_on_a_hidden_split_are_scored_again_and_what_changed_is_said(tmp_path, monkeypatch):
    store, old, words = board_of_one(tmp_path, monkeypatch)
    store.add(replace(old, team="others", estimates={}))
    tried = CliRunner().invoke(main, [*words, "--dry-run"])
    assert tried.exit_code == 0, tried.output
    assert len(store.digests()) == 2
    told = CliRunner().invoke(main, [*(word for word in words if word != "--json"), "--dry-run"])
    assert re.search(r"score 0\.125 -> 0\.\d{3}, now rank \(1\)\n", told.stdout), told.stdout
    assert "nothing was written" in told.stderr
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    assert "others" in done.stderr
    assert "its estimates were not kept" in done.stderr
    (change,) = json.loads(done.stdout)
    assert change["before"] == {"record": old.digest, "score": 0.125, "place": 1, "rank": None}
    made = store.record(change["after"]["record"])
    assert (made.supersedes, made.evaluator_version, made.estimates) == (old.digest, "slam 3", old.estimates)
    assert made.curves == ""  # a path would give the hidden truth away
    assert change["after"]["score"] == json.loads(tried.stdout)[0]["after"]["score"]
    assert 0.5 < change["after"]["score"] < 1
    again = CliRunner().invoke(main, words)
    assert json.loads(again.stdout) == []
    assert len(store.digests()) == 3


def test_what_is_withdrawn_does_not_come_back_by_being_scored_again(tmp_path, monkeypatch):
    """Its record by the former evaluator is current again on its own board, and has the same estimates."""
    store, old, words = board_of_one(tmp_path, monkeypatch)
    made = json.loads(CliRunner().invoke(main, words).stdout)[0]["after"]["record"]

    def call(command, digest):
        done = CliRunner().invoke(main, ["leaderboard", command, digest, "--reason", "made from the truth"])
        assert done.exit_code == 0, done.output

    call("withdraw", made)
    done = CliRunner().invoke(main, words)
    assert json.loads(done.stdout) == []
    assert f"{made[:8]}, scored from the same estimates, is withdrawn; restore that one" in done.stderr
    call("withdraw", old.digest)
    named = [*words[:2], old.digest, *words[2:]]
    assert "it is withdrawn; `oysterbench leaderboard restore" in CliRunner().invoke(main, named).stderr
    assert len(store.digests()) == 2
    call("restore", made)
    call("restore", old.digest)
    assert json.loads(CliRunner().invoke(main, words).stdout) == []
    # What replaced it with other estimates says nothing of these.
    other = store.add(replace(old, estimates={}, supersedes=old.digest, created="2031-01-01T00:00:00Z"))
    call("withdraw", made)
    call("withdraw", other)
    assert "scored from the same estimates" in CliRunner().invoke(main, words).stderr


def test_what_is_withdrawn_does_not_come_back_where_its_record_cannot_be_read(tmp_path, monkeypatch):
    """It may have been scored from the same estimates."""
    store, old, words = board_of_one(tmp_path, monkeypatch)
    made = json.loads(CliRunner().invoke(main, words).stdout)[0]["after"]["record"]
    done = CliRunner().invoke(main, ["leaderboard", "withdraw", made, "--reason", "made from the truth"])
    assert done.exit_code == 0, done.output
    with open(tmp_path / "board" / "records" / f"{made}.json", "ab") as file:
        file.write(b" ")
    done = CliRunner().invoke(main, words)
    assert (done.exit_code, json.loads(done.stdout)) == (3, []), done.output
    assert f"{old.digest[:8]} (carp by reef lab) was not rescored: {made[:8]}, which superseded it" in done.stderr
    assert "its bytes do not match its name" in done.stderr
    assert len(store.digests()) == 2


def test_a_record_of_a_track_that_is_not_scored_again_is_told_so_by_its_name(tmp_path, monkeypatch):
    monkeypatch.setenv("OYSTERBENCH_BOARD", str(tmp_path / "board"))
    monkeypatch.setattr("oysterbench_leaderboard.submissions.catalogue.SCORED", ("slam",))
    record = next(one for one in records_made().values() if one.track == "steering")
    RecordStore(tmp_path / "board").add(record)
    words = ["leaderboard", "rescore", record.digest, "--estimates", str(tmp_path)]
    told = CliRunner().invoke(main, words)
    assert "was not rescored: its estimates were not kept" in told.stderr
    assert told.stdout == ""


def test_a_damaged_record_is_named_and_the_others_are_scored_again(tmp_path, monkeypatch):
    store, old, words = board_of_one(tmp_path, monkeypatch)
    damaged = store.add(replace(old, team="others"))
    assert CliRunner().invoke(main, [*words, "--dry-run"]).exit_code == 0  # both are in the index now
    (tmp_path / "board" / "records" / f"{damaged}.json").write_bytes(b"{}")
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 3, done.output
    assert f"{damaged[:8]} (" in done.stderr
    assert "its bytes do not match its name" in done.stderr
    assert [change["before"]["record"] for change in json.loads(done.stdout)] == [old.digest]
