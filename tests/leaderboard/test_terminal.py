"""`oysterbench leaderboard` and what `oysterbench compare` takes from the board, as they are typed."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from oysterbench.cli.main import main
from oysterbench.results.records import read_results, write_results
from oysterbench_leaderboard import command as group
from oysterbench_leaderboard.storage.store import RecordStore
from oysterbench_leaderboard.submissions.database import SubmissionDatabase, log_event
from oysterbench_leaderboard.submissions.settings import load_settings
from tests.helpers.records_made import fill, record_made


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RecordStore:
    """The small leaderboard, which the commands take for theirs."""
    monkeypatch.setenv("OYSTERBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("OYSTERBENCH_BOARD", str(tmp_path / "board"))
    monkeypatch.delenv("OYSTERBENCH_INDEX", raising=False)
    store = RecordStore(tmp_path / "board")
    store.folder.mkdir()
    return store


def typed(*words: object, code: int = 0) -> Result:
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == code, (result.output, result.exception)
    return result


def shown(*words: object, code: int = 0) -> Result:
    return typed("leaderboard", *words, code=code)


def refused(*words: object) -> str:
    """What is said in one line."""
    result = typed(*words, code=1)
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    return result.stderr


def test_it_lists_the_boards_with_the_top_of_each(board):
    fill(board)
    result = shown()
    assert "slam on slam-val (slam 3)" in result.stdout
    assert "segmentation on seg-val (segmentation 1)" in result.stdout
    assert "slam 2" not in result.stdout
    assert "one board is of an older evaluator or a former recipe, and left out: --all shows all" in result.stderr
    assert "slam 2" in shown("--all").stdout
    assert "older evaluator" not in shown("--all").stderr
    assert "5 of 8 rows" in result.stdout


def test_ties_are_marked_also_where_the_other_row_is_not_shown(board):
    fill(board)
    lines = shown("--track", "slam", "--split", "slam-val", "--rows", 1).stdout.splitlines()
    (carp,) = [line for line in lines if " carp " in line]
    assert carp.split()[0] == "=1"


def test_json_csv_tex_and_md_say_the_same(board, tmp_path):
    digests = fill(board)
    found = json.loads(shown("--split", "slam-val", "--json").stdout)["boards"][0]
    written = shown("--split", "slam-val", "--csv", "-").stdout
    names = written.splitlines()[0].split(",")
    assert len(set(names)) == len(names)
    rows = list(csv.DictReader(io.StringIO(written)))
    assert [row["digest"] for row in found["rows"]] == [row["digest"] for row in rows]
    assert found["rows"][0]["digest"] == digests["carp2"]
    for row, line in zip(found["rows"], rows, strict=True):
        assert float(line["score"]) == row["score"]
        assert float(line["coverage"]) == row["coverage"] == row["metrics"]["coverage"]
        assert float(line["ate_percent"]) == row["metrics"]["ate_percent"]
        assert not line["method"].startswith("=")  # no spreadsheet takes it for a formula
    shown("--split", "slam-val", "--tex", tmp_path / "t.tex", "--md", tmp_path / "t.md")
    assert "\\input" not in (tmp_path / "t.tex").read_text()
    for text in ((tmp_path / "t.tex").read_text(), (tmp_path / "t.md").read_text()):
        assert text.index("carp") < text.index("cod") < text.index("drift")


def test_csv_has_all_rows_of_several_boards_unless_fewer_are_asked_for(board):
    fill(board)
    assert "5 of 8 rows" in shown().stdout
    rows = list(csv.DictReader(io.StringIO(shown("--csv", "-").stdout)))
    assert sum(row["split"] == "slam-val" for row in rows) == 8
    assert len(shown("--rows", 1, "--csv", "-").stdout.splitlines()) == 1 + len({row["board"] for row in rows})
    assert "a line per record" in shown("--help").stdout


def test_what_is_asked_wrongly_is_refused_in_one_line(board):
    fill(board)
    assert "slam on slam-val, segmentation on seg-val" in refused("leaderboard", "--split", "nowhere")
    assert "no record of 'nobody'" in refused("leaderboard", "history", "nobody")
    rows = json.loads(shown("--all", "--json").stdout)
    first = json.dumps(rows)
    told = refused("leaderboard", "--id", "slam")
    (one, *_) = re.findall(r"([0-9a-f]{16}) \(slam on slam-val\)", told)
    assert "no board slam; `oysterbench leaderboard --all --json` has the ids: " in told
    assert one in first
    told = refused("leaderboard", "show", "0" * 12)
    assert "no such record: 000000000000; `oysterbench leaderboard --json` has the digests" in told
    assert "hex digits" in refused("leaderboard", "show", "carp")
    assert "nothing is listed" in refused("leaderboard", "literature", "--track", "golf")
    shown("--json", "--csv", "-", code=2)
    shown("--track", "slam", "verify", code=2)


def test_names_that_were_nearly_right_are_suggested_and_lists_end_in_whole_names(board):
    fill(board)
    assert "did you mean slam-val or seg-val? there are: " in refused(
        "leaderboard", "--track", "slam", "--split", "slam-vall"
    )
    assert "did you mean detection? " in refused("leaderboard", "--track", "detect")
    for k in range(30):
        board.add(record_made(f"a-method-with-a-long-name-{k:02d}"))
    told = refused("leaderboard", "history", "carpp")
    assert "did you mean carp? the methods are: " in told
    assert re.search(r"a-method-with-a-long-name-\d\d and \d+ more$", told.strip())
    told = refused("compare", "carpp", "cod")
    assert "did you mean carp? the methods are: " in told
    assert told.strip().endswith(" more")


def test_a_board_without_current_records_says_so(board):
    digest = board.add(record_made())
    shown("withdraw", digest[:8], "--reason", "A mistake.")
    result = shown()
    assert result.stdout == ""
    assert "slam on slam-val (slam 3): no current record: those that it had are withdrawn" in result.stderr
    shown("restore", digest[:8], "--reason", "None.")
    assert "no row with 'x'" in shown("--search", "x").stderr


def test_a_folder_that_is_not_there_is_named(board, tmp_path):
    assert "no-such-board" in refused("leaderboard", "--board", tmp_path / "no-such-board")


def test_a_record_is_shown_with_its_numbers_by_sequence_and_its_failures(board):
    digests = fill(board)
    text = shown("show", digests["eel"][:8]).stdout
    for word in ("harbour group", digests["eel"], "val-08", "lost track after 3 s", "failed or lacking: 2"):
        assert word in text
    whole = json.loads(shown("show", digests["eel"], "--json").stdout)
    assert whole["record"] == board.record(digests["eel"]).to_dict()
    assert "made from the truth" in shown("show", digests["fraud"]).stdout


def test_history_holds_what_was_superseded(board):
    digests = fill(board)
    rows = json.loads(shown("history", "carp", "--json").stdout)
    assert [(row["digest"], row["state"]) for row in rows] == [
        (digests["carp2"], "current"),
        (digests["carp1"], "superseded"),
    ]
    assert digests["carp1"][:8] in shown("history", "carp").stdout


def test_results_are_added_once_and_in_place_of_earlier_ones(board, tmp_path):
    path = tmp_path / "results.json"
    write_results(path, record_made().results)
    words = ("--team", "reef lab", "--tier", "baseline", "--summary", "Smooths a window.")
    first = json.loads(shown("add", path, *words, "--json").stdout)
    assert [(one["new"], one["place"]) for one in first] == [(True, 1)]
    assert "already there" in shown("add", tmp_path, *words).stdout
    write_results(path, record_made(skill=0.9, created="2026-12-01T00:00:00Z").results)
    (second,) = json.loads(shown("add", path, *words, "--reason", "A longer window.", "--json").stdout)
    record = board.record(second["record"])
    assert (record.supersedes, record.reason) == (first[0]["record"], "A longer window.")
    assert record.results == tuple(read_results(path))
    assert len(board.digests()) == 2


def test_reported_results_take_no_place_of_scored_ones(board, tmp_path):
    path = tmp_path / "results.json"
    scored = board.add(record_made())
    write_results(path, record_made(skill=0.9, created="2026-12-01T00:00:00Z").results)
    words = ("add", path, "--team", "reef lab")
    told = shown(*words, code=1).stderr
    assert f"has a scored record, {scored[:8]}, which a reported one does not replace: give another --team" in told
    assert f"`oysterbench leaderboard withdraw {scored[:8]} --reason" in told
    assert board.digests() == [scored]
    assert "kept: carp" in shown("add", path, "--team", "another lab").stdout
    shown("withdraw", scored[:8], "--reason", "A mistake.")
    assert "kept: carp" in shown(*words).stdout
    shown("restore", scored[:8], "--reason", "It was none.")
    states = {
        row["tier"]: row["state"] for row in json.loads(shown("history", "carp", "--team", "reef lab", "--json").stdout)
    }
    assert states == {"scored": "current", "reported": "superseded"}
    assert "place 1 of" in shown(*words, "--tier", "scored").stdout


def test_results_that_belong_on_no_board_are_refused(board, tmp_path):
    path = tmp_path / "results.json"
    results = list(record_made().results)
    from dataclasses import replace

    write_results(path, [replace(results[0], split="")])
    assert "belong to no split" in refused("leaderboard", "add", path, "--team", "x")
    write_results(path, [replace(results[0], split="", method="hid-01-carp.tum")])
    said = refused("leaderboard", "add", path, "--team", "x")
    assert "results of hid-01-carp.tum belong to no split" in said
    assert "`oysterbench run METHOD --split SPLIT`" in said, "a file that was scored is no method to run"
    write_results(path, [results[0], replace(results[1], evaluator_version="slam 2")])
    assert "would be averaged" in refused("leaderboard", "add", path, "--team", "x")
    write_results(path, [results[0], replace(results[1], method_settings={"window_s": 9.0})])
    assert "several settings" in refused("leaderboard", "add", path, "--team", "x")
    write_results(path, [])
    assert "no result" in refused("leaderboard", "add", path, "--team", "x")
    path.write_text("{")
    assert "not valid JSON" in refused("leaderboard", "add", path, "--team", "x")
    assert board.digests() == []


def test_a_withdrawal_is_said_and_can_be_taken_back(board):
    digests = fill(board)
    assert "is withdrawn already" in refused("leaderboard", "withdraw", digests["fraud"], "--reason", "Again.")
    assert "expected a reason" in refused("leaderboard", "withdraw", digests["cod"], "--reason", " ")
    shown("withdraw", digests["cod"][:8], "--reason", "By mistake.")
    assert "By mistake." in shown("show", digests["cod"]).stdout
    assert "cod" not in shown("--split", "slam-val").stdout
    shown("restore", digests["cod"][:8], "--reason", "It was none.")
    assert "cod" in shown("--split", "slam-val").stdout


def test_verify_names_what_is_damaged_and_exits_with_3(board):
    digests = fill(board)
    assert "all intact" in shown("verify").stdout
    path = board.folder / "records" / f"{digests['cod']}.json"
    path.write_bytes(path.read_bytes()[:-2])
    (board.folder / "changes" / "readme.txt").write_text("x")
    text = shown("verify", code=3).stdout
    assert f"records/{digests['cod']}.json" in text
    assert "changes/readme.txt" in text
    assert "2 damaged" in text
    assert f"left out: {digests['cod'][:12]}" in shown("rebuild").stderr


def test_compare_takes_methods_and_records_of_the_board(board, tmp_path):
    digests = fill(board)
    found = json.loads(typed("compare", "carp", "drift", "--split", "slam-val", "--json").stdout)["comparisons"]
    assert len(found) == 1
    whole = next(pair for pair in found[0]["pairs"] if not pair["condition"])
    assert (whole["a"], whole["b"], whole["verdict"]) == ("carp", "drift", "better")
    assert {pair["condition"] for pair in found[0]["pairs"]} > {"", "water"}
    by_digest = json.loads(typed("compare", digests["carp1"][:8], digests["carp2"][:12], "--json").stdout)
    assert by_digest["comparisons"][0]["pairs"][0]["difference"] == 0
    write_results(tmp_path / "mine.json", record_made("mine", skill=0.6).results)
    assert "mine" in typed("compare", tmp_path / "mine.json", "cod").stdout
    assert "no such file" in refused("compare", "nobody.json", "carp")
    assert "no such file" in refused("compare", "runs/nobody", "carp")
    told = refused("compare", "nobody", "carp")
    assert "nobody: is neither a file nor a method on the board; the methods are: " in told
    assert all(f" {method}" in told for method in ("carp", "cod", "drift", "unet"))
    told = refused("compare", "nobody", "carp", "--split", "seg-val")
    assert told.strip().endswith("the methods on seg-val are: boxes, colour, unet")
    assert "on no board of seg-val" in refused("compare", "carp", "cod", "--split", "seg-val")
    board.add(record_made(team="another"))
    assert "several teams have a method named carp" in refused("compare", "carp", "cod")


def test_every_command_is_known_by_its_line_and_has_examples():
    for name in group.COMMANDS:
        result = CliRunner().invoke(main, ["leaderboard", name, "--help"])
        if name in ("serve", "build") and isinstance(result.exception, SystemExit) and result.exit_code:
            continue  # brought by the site, where it is installed
        assert result.exit_code == 0, name
        assert "Examples" in result.output, name


def test_what_comes_with_oysterbench_can_be_read_and_is_whole(tmp_path):
    where = Path(group.__file__).parent
    shown("--board", where, "--index", tmp_path / "index.sqlite", "verify")
    listed = shown("--board", where, "--index", tmp_path / "index.sqlite", "--json").stdout
    assert any(board["rows"] for board in json.loads(listed)["boards"])


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from click.testing import CliRunner; from oysterbench.cli.main import main; "
        "assert CliRunner().invoke(main, ['leaderboard', '--help']).exit_code == 0; "
        "print([name for name in ('numpy', 'scipy', 'sqlalchemy', 'pandas', 'cv2') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=os.environ, check=True)
    assert done.stdout.strip() == "[]"


def test_the_log_of_submissions_obeys_no_stranger(board, tmp_path):
    private = tmp_path / "private"
    typed("leaderboard", "team", "add", "reef lab", "--submissions", private)
    with SubmissionDatabase(load_settings(private)).writing() as connection:
        log_event(connection, "2026-11-01T00:00:00Z", "stranger\x1b[2J", "refused", why="archive: \x9b2J\u202e.png\r!")
    printed = typed("leaderboard", "submissions", "log", "--submissions", private).output
    assert "stranger\\u001b[2J  refused    archive: \\u009b2J\\u202e.png\\r!\n" in printed
    assert json.loads(typed("leaderboard", "submissions", "log", "--submissions", private, "--json").output)


def test_a_track_with_nothing_but_a_former_recipe_names_the_option_that_shows_it(board):
    new = record_made("new", track="segmentation", split="seg-val")
    new = replace(new, results=tuple(replace(one, split_digest="d1" * 32) for one in new.results))
    boxes = record_made("boxes", track="detection", split="seg-val", created="2026-10-01T00:00:00Z")
    fill(board, {"boxes": boxes, "new": new})
    assert "--all shows those of former ones" in refused("leaderboard", "--track", "detection")
    assert "boxes" in shown("--track", "detection", "--all").stdout


def test_the_command_that_was_meant_is_named():
    for words, meant in ((("leaderbord",), "leaderboard"), (("submt",), "submit"), (("leaderboard", "serv"), "serve")):
        assert f"No such command {words[-1]!r}. Did you mean {meant}?" in typed(*words, code=2).stderr
