"""A server as one file, and another server of it."""

from __future__ import annotations

import io
import json
import shutil
import stat
import tarfile
from contextlib import closing

import pytest

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.submissions.accounts.tokens import issue, recognise
from oysterbench_leaderboard.submissions.backup import backup, restore
from oysterbench_leaderboard.submissions.database import SubmissionDatabase, find, log
from oysterbench_leaderboard.submissions.estimates import upload_of
from oysterbench_leaderboard.submissions.sandbox import sandbox, sandbox_worker
from oysterbench_leaderboard.submissions.settings import load_settings
from oysterbench_leaderboard.submissions.words import Form
from tests.helpers.command import assert_one_line, run
from tests.helpers.pool import answers, lay_split
from tests.helpers.served import drain, make_service


@pytest.fixture(scope="module", autouse=True)
def _here():
    """What the sandbox does, done in this process: its answers are the same, and quicker."""
    with pytest.MonkeyPatch.context() as patch:
        answer = lambda job, *args: sandbox.Ended(json.loads(json.dumps(sandbox_worker.do(job))), "", "")  # noqa: E731
        patch.setattr(sandbox, "run", answer)
        yield


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A folder with a server that has one published submission and one that waits, and its backup."""
    folder = tmp_path_factory.mktemp("saved")
    lay_split(folder / "splits")
    with closing(make_service(folder)) as service:
        token = issue(service.database, "reef lab")
        for method, case in (("carp", 0), ("tench", 1)):
            path = service.incoming / method
            path.write_bytes(answers(folder, case))
            made, _ = service.submit("reef lab", Form(method, "pool-test"), upload_of(path))
            if method == "carp":
                drain(service)
                service.publish("reef lab", made.id)
        made = backup(service.settings, folder / "all.tar", service.store.folder)
        with service.database.reading() as connection:
            events = log(connection)
    return folder, token, made, events


def all_of(folder):
    with closing(SubmissionDatabase(load_settings(folder))) as database, database.reading() as connection:
        return {one.method: one for one in find(connection)}


def test_what_is_restored_is_what_was_and_scores_what_it_would_have_scored(saved, tmp_path):
    folder, token, made, events = saved
    other = tmp_path / "other"
    shutil.copytree(folder / "splits", other / "splits")
    assert restore(folder / "all.tar", other / "private", other / "board") == made
    assert all_of(other / "private") == all_of(folder / "private")
    with closing(make_service(other)) as service, service.database.reading() as connection:
        assert recognise(connection, token).team == "reef lab"
        assert [{**row, "number": 0} for row in log(connection)] == [{**row, "number": 0} for row in events]
        assert service.store.digests() == [all_of(folder / "private")["carp"].published]
    scored = []
    for place in (folder, other):
        with closing(make_service(place)) as service:
            assert drain(service) == 1
            scored.append(all_of(place / "private")["tench"].record)
    assert scored[0] == scored[1] != ""


def test_it_goes_from_sqlite_to_postgresql(saved, tmp_path, postgres):
    folder, _, made, _ = saved
    private = tmp_path / "private"
    private.mkdir()
    (private / "settings.toml").write_text(f"database = {postgres!r}\n")
    assert restore(folder / "all.tar", private).rows == made.rows
    assert all_of(private)["carp"] == all_of(folder / "private")["carp"]
    with closing(SubmissionDatabase(load_settings(private))) as database:
        issue(database, "others")  # numbers of events go on
    shutil.rmtree(private / "estimates")
    for path in ("scored", "key"):
        shutil.rmtree(private / path, ignore_errors=True)
    with pytest.raises(ResultError, match="its database holds tables already"):
        restore(folder / "all.tar", private)


@pytest.mark.parametrize("made", [True, False])
def test_a_folder_that_is_no_boards_is_not_backed_up_as_one(saved, tmp_path, made):
    """Its backup would have none of the records, withdrawals and baselines, and say nothing."""
    folder, *_ = saved
    board, private = tmp_path / "nowhere", ("--submissions", folder / "private")
    board.mkdir() if made else None
    done = run("leaderboard", "--board", board, "submissions", "backup", tmp_path / "b.tar", *private)
    assert_one_line(done, f"--board {board}: expected the folder of a board", code=ResultError.exit_code)
    assert not (tmp_path / "b.tar").exists()
    done = run("leaderboard", "--board", folder / "board", "submissions", "backup", tmp_path / "b.tar", *private)
    assert done.stdout.endswith(" files, with 1 record of the board\n")


def test_nothing_that_is_there_is_written_over(saved, tmp_path):
    folder, *_ = saved
    for full in ("private", "board"):
        (tmp_path / full).mkdir()
        (tmp_path / full / "something").write_text("kept")
        done = run(
            "leaderboard", "--board", tmp_path / "board", "submissions", "restore", folder / "all.tar",
            "--submissions", tmp_path / ("private" if full == "private" else "new"),
        )  # fmt: skip
        assert_one_line(done, f"{tmp_path / full}: expected an empty or new folder", code=ResultError.exit_code)
    assert not (tmp_path / "new").exists()


def test_only_its_owner_can_read_it(saved):
    assert stat.S_IMODE((saved[0] / "all.tar").stat().st_mode) == 0o600


def rewrite(source, target, changed):
    """An archive, each name and data of which are changed."""
    with tarfile.open(source) as before, tarfile.open(target, "w") as after:
        for entry in before.getmembers():
            entry.name, data = changed(entry.name, before.extractfile(entry).read())
            entry.size = len(data)
            after.addfile(entry, io.BytesIO(data))


def test_a_backup_of_an_earlier_version_is_taken_to_this_one(saved, tmp_path):
    def earlier(name, data):
        if name == "backup.json":
            return name, json.dumps({"oysterbench": "0.0", "revision": "0001"}).encode()
        if name == "rows/submissions.jsonl":
            return name, data.replace(b'"attempt":', b'"lease": 0.0, "attempt":')
        return name, data

    rewrite(saved[0] / "all.tar", tmp_path / "all.tar", earlier)
    restore(tmp_path / "all.tar", tmp_path / "private")
    assert all_of(tmp_path / "private")["carp"] == all_of(saved[0] / "private")["carp"]


@pytest.mark.parametrize("change", ["flipped", "strange name", "later", "no archive"])
def test_a_file_that_is_damaged_or_none_of_ours_is_refused(saved, tmp_path, change):
    file = tmp_path / "all.tar"

    def changed(name, data):
        if change == "flipped" and name.startswith("private/estimates/"):
            return name, bytes([data[0] ^ 1]) + data[1:]
        if change == "strange name" and name.startswith("private/scored/"):
            return "private/../../key", data
        return name, data.replace(b'"revision": "', b'"revision": "9') if change == "later" else data

    if change == "no archive":
        file.write_bytes(b"carp" * 1000)
    else:
        rewrite(saved[0] / "all.tar", file, changed)
    with pytest.raises(ResultError, match=r"all\.tar: cannot be restored") as refused:
        restore(file, tmp_path / "private")
    assert "\n" not in str(refused.value)
    assert not (tmp_path.parent / "key").exists()


def test_a_backup_whose_rows_are_damaged_is_called_so(saved, tmp_path):
    def cut(name, data):
        return name, data[:-20] if name == "rows/submissions.jsonl" else data

    rewrite(saved[0] / "all.tar", tmp_path / "all.tar", cut)
    why = f"the backup is damaged, or none of oysterbench .*; empty {tmp_path / 'private'}, and restore another one"
    with pytest.raises(ResultError, match=rf"all\.tar: cannot be restored: {why}"):
        restore(tmp_path / "all.tar", tmp_path / "private")


def test_a_backup_that_was_cut_off_anywhere_is_refused_before_anything_is_written(saved, tmp_path):
    whole, file, private = (saved[0] / "all.tar").read_bytes(), tmp_path / "all.tar", tmp_path / "private"
    for size in range(tarfile.BLOCKSIZE, whole.rstrip(b"\0").rindex(b"}"), tarfile.BLOCKSIZE):
        file.write_bytes(whole[:size])
        with pytest.raises(ResultError, match="the backup is damaged"):
            restore(file, private)
        assert not private.exists()


def test_a_damaged_file_is_named_and_spoils_no_backup(saved, tmp_path):
    for name in ("private", "board"):
        shutil.copytree(saved[0] / name, tmp_path / name)
    spoilt = [*(tmp_path / "board" / "records").iterdir(), *(tmp_path / "private" / "estimates").iterdir()][:2]
    for path in spoilt:
        path.chmod(0o600)
        path.write_bytes(path.read_bytes() + b" ")
    words = ("--submissions", tmp_path / "private")
    done = run("leaderboard", "--board", tmp_path / "board", "submissions", "backup", tmp_path / "a.tar", *words)
    assert done.returncode == 3
    assert done.stderr.count("is damaged, and not in the backup") == 2
    assert all(str(path) in done.stderr for path in spoilt)
    kept = restore(tmp_path / "a.tar", tmp_path / "again" / "private", tmp_path / "again" / "board")
    assert kept.records == saved[2].records - 1
    assert not list((tmp_path / "again").rglob(spoilt[1].name))
    assert set(all_of(tmp_path / "again" / "private")) == {"carp", "tench"}


def test_files_that_cannot_be_read_or_are_gone_are_named_and_spoil_no_backup(saved, tmp_path):
    for name in ("private", "board"):
        shutil.copytree(saved[0] / name, tmp_path / name)
    (record,), (upload, gone) = ((tmp_path / name).iterdir() for name in ("board/records", "private/estimates"))
    record.unlink()
    record.symlink_to(tmp_path / "failed disk" / record.name)
    upload.unlink()
    upload.mkdir()
    gone.unlink()
    done = run(
        "leaderboard", "--board", tmp_path / "board", "submissions", "backup", tmp_path / "a.tar", "--json",
        "--submissions", tmp_path / "private",
    )  # fmt: skip
    assert done.returncode == 3
    assert json.loads(done.stdout)["damaged"] == {
        str(gone): "it is not there",
        str(upload): "it cannot be read: Is a directory",
        str(record): "it cannot be read: No such file or directory",
    }
    assert done.stderr.count("is damaged, and not in the backup: it ") == 3
    restore(tmp_path / "a.tar", tmp_path / "again" / "private", tmp_path / "again" / "board")
    assert set(all_of(tmp_path / "again" / "private")) == {"carp", "tench"}


def test_files_on_another_disk_are_saved_themselves_and_not_the_links_to_them(saved, tmp_path):
    for name in ("private", "board"):
        shutil.copytree(saved[0] / name, tmp_path / name)
    for path in [*(tmp_path / "board" / "records").iterdir(), *(tmp_path / "private" / "estimates").iterdir()]:
        path.symlink_to(shutil.move(path, tmp_path / f"moved-{path.name}"))
    made = backup(load_settings(tmp_path / "private"), tmp_path / "a.tar", tmp_path / "board")
    assert (made.records, made.damaged) == (1, {})
    assert restore(tmp_path / "a.tar", tmp_path / "again" / "private", tmp_path / "again" / "board") == made


def test_it_is_done_by_commands(saved, tmp_path):
    folder, *_ = saved
    file, private = tmp_path / "again.tar", tmp_path / "private"
    done = run("leaderboard", "submissions", "backup", file, "--submissions", folder / "private")
    assert done.returncode == 0
    assert "2 submissions" in done.stdout
    done = run("leaderboard", "submissions", "restore", file, "--submissions", private)
    assert done.returncode == 0
    assert set(all_of(private)) == {"carp", "tench"}


def test_estimates_in_a_folder_of_their_own_are_kept_hidden_saved_and_restored(tmp_path):
    lay_split(tmp_path / "splits")
    private, elsewhere = tmp_path / "private", tmp_path / "large disk" / "estimates"
    private.mkdir()
    (private / "settings.toml").write_text(f"estimates = {str(elsewhere)!r}\n")
    with closing(make_service(tmp_path)) as service:
        path = service.incoming / "carp"
        path.write_bytes(answers(tmp_path, 0))
        made, _ = service.submit("reef lab", Form("carp", "pool-test"), upload_of(path))
        assert str(elsewhere) in service.hidden
        assert [path.name for path in elsewhere.iterdir()] == [made.digest]
        assert drain(service) == 1
        saved = backup(service.settings, tmp_path / "all.tar")
    shutil.rmtree(elsewhere.parent)
    shutil.move(private, tmp_path / "lost")
    assert restore(tmp_path / "all.tar", private) == saved
    assert [path.name for path in elsewhere.iterdir()] == [made.digest]
    assert {path.name for path in private.iterdir()} == {"settings.toml", "scored", "submissions.sqlite"}
