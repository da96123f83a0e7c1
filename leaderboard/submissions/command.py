"""`oysterbench submit`: send results or estimates to a leaderboard."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.echo import echo, message
from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench.core.names import counted, did_you_mean, listed, nearest

if TYPE_CHECKING:
    from oysterbench_leaderboard.submissions.sending.package import Found

TOKEN = "OYSTERBENCH_TOKEN"
EXPECTED_TOKEN = f"expected a team's token in --team-token-file FILE or {TOKEN}; the operators of the board give one"


@click.command("submit", short_help="Send results or estimates to a leaderboard.")
@click.argument("place", metavar="RESULT_OR_ESTIMATES", type=click.Path(path_type=Path))
@click.option("--to", "url", required=True, envvar="OYSTERBENCH_BOARD_URL", help="Address of the leaderboard.")
@click.option("--method", required=True, help="Name of the method on the board.")
@click.option("--split", help="Split it was run on.  [default: from the results or the names]")
@click.option("--track", help="Track, if the split has several.  [default: its first]")
@click.option("--of", "of", default="", help="Which method's estimates, if the folder has several.")
@click.option(
    "--run", type=click.IntRange(min=1), default=1, show_default=True, help="Which run, if there are several."
)
@click.option("--results", is_flag=True, help="Send a folder's results.json, not its estimates.")
@click.option("--team-token-file", type=click.Path(path_type=Path), help=f"File with the token.  [default: {TOKEN}]")
@click.option("--url", "about", default="", help="Address of the method's description.")
@click.option("--summary", default="", help="The method in one sentence.")
@click.option("--check", "only_check", is_flag=True, help="Check the files, and send nothing.")
@click.option("--publish", is_flag=True, help="Publish on the board once it is scored.")
@click.option("--wait/--no-wait", default=True, show_default=True, help="Wait until it is scored.")
@click.option("--json", "as_json", is_flag=True, help="Print the submission, or what --check found, as JSON.")
def command(
    place: Path,
    url: str,
    method: str,
    split: str | None,
    track: str | None,
    of: str,
    run: int,
    results: bool,
    team_token_file: Path | None,
    about: str,
    summary: str,
    only_check: bool,
    publish: bool,
    wait: bool,
    as_json: bool,
) -> None:
    """Send results or estimates to a leaderboard, and print their score.

    \b
    Examples:
      oysterbench submit estimates/ --to https://board.example --method carp --split slam-test
      oysterbench submit estimates/ --to https://board.example --method carp --split slam-test --check
      oysterbench submit results/ --to https://board.example --method carp --of my_slam --publish
      oysterbench submit results.json --to https://board.example --method carp
      oysterbench submit masks.npz --to https://board.example --method net --split seg-test --track detection

    \b
    What can be sent:
      a folder with one file per sequence: SEQUENCE.tum, .txt, .csv (EuRoC or named columns), .npz
      the output of `oysterbench run` and `eval` on the track slam
      for public splits also the results.json of any track, marked as reported: --results
      masks: SEQUENCE/CAMERA/STAMP.png in a folder, an .npz with an array per image, or COCO annotations
      commands: SEQUENCE.csv with columns stamp_ns,yaw,pitch, or with the probabilities of all classes
      a zip archive of any of these

    The files are first checked locally, with the server's own checks; with --check, that is all, and it costs no
    attempt. Sending them twice makes one submission.
    """
    if only_check and publish:
        raise click.UsageError("--check sends nothing: it cannot be combined with --publish")
    if publish and not wait:
        raise click.UsageError("--publish waits until the submission is scored: it cannot be combined with --no-wait")
    if not place.exists():
        raise ResultError(f"{place}: no such file or folder; expected results, or estimates as `run` writes them")
    from oysterbench.cli.progress import bytes_bar
    from oysterbench_leaderboard.submissions.catalogue import why
    from oysterbench_leaderboard.submissions.sending.client import Client
    from oysterbench_leaderboard.submissions.sending.package import find_package, packed, split_in, wanted_of
    from oysterbench_leaderboard.submissions.words import Form

    client = Client(url, _token(team_token_file), notify=message)
    Form(method, split or "", track or "", about, summary).check()
    if client.open:
        message(f"{url}: without https, others can read the token and the upload")
    offered = client.splits()
    known_split, known_track = split_in(place)
    chosen = _choose(offered["splits"], split or known_split, place)
    of_track = track or known_track or chosen["tracks"][0]
    if of_track not in chosen["tracks"]:
        where = "--track" if track else f"{place}: its track"
        raise ResultError(
            f"{where}: {chosen['split']} has {', '.join(chosen['tracks'])}, got {of_track!r:.60}{why(of_track)}"
        )
    results = results or "estimates" not in chosen["takes"]
    found = find_package(place, chosen["sequences"], of, run, results)
    with packed(found, wanted_of(chosen["split"], of_track, chosen), offered["limits"]) as package:
        for note in package.facts["notes"]:
            message(note)
        message(f"checked: {_described(package.facts)}; {package.size / 1e6:.3g} MB to send")
        if absent := [name for name in chosen["sequences"] if name not in package.facts["sequences"]]:
            message(f"no estimate is sent for {', '.join(absent)}: counted as failed there")
        if note := _other_runs(found, run):
            message(note)
        if found.others:
            message(f"not sent, as named for no sequence of {chosen['split']}: {listed(found.others)}")
        if only_check:
            message("nothing was sent: the same command without --check sends it")
            if as_json:
                echo(json.dumps(package.facts, indent=2))
            return
        with bytes_bar("sending") as progress:
            sent = client.send(package, method, about, summary, progress)
    message(f"submission {sent['id']}: {url.rstrip('/')}{sent['page']}")
    if note := _unchanged(sent, {"summary": summary, "address": about}):
        message(note)
    if wait:
        sent = client.wait(sent["id"], lambda now: message(f"{now['state']}{_before(now)}"))
        if publish and sent["state"] == "done":
            sent = client.publish(sent["id"])
    _show(sent, as_json)


def _token(file: Path | None) -> str:
    if file is not None:
        try:
            token = file.read_text(encoding="utf-8").strip()
            shared = file.stat().st_mode & 0o077
        except OSError as error:
            raise ResultError(f"--team-token-file: {file}: {error.strerror}; {EXPECTED_TOKEN}") from None
        except UnicodeDecodeError:
            raise ResultError(f"--team-token-file: {file}: not text: expected a team's token, oyb_...") from None
        if shared:
            message(f"{file}: others on this machine may read this token; `chmod 600 {file}` keeps them out")
    else:
        token = os.environ.get(TOKEN, "").strip()
    if not token or not token.isascii() or not token.isprintable():
        raise ResultError(EXPECTED_TOKEN)
    return token


def _choose(splits: list[dict[str, Any]], name: str, place: Path) -> dict[str, Any]:
    """Return the split of that name, or the only one that matches the file names."""
    known = {one["split"]: one for one in splits}
    if name:
        if name not in known:
            meant = did_you_mean(nearest(name, known)).strip()
            raise ResultError(
                f"{name}: this leaderboard accepts submissions to {', '.join(known) or 'no split'}"
                + (f"; {meant}" if meant else "")
            )
        return known[name]
    names = {path.stem for path in place.iterdir()} if place.is_dir() else set()
    fits = [one for one in splits if names & set(one["sequences"])]
    if len(fits) != 1:
        raise click.UsageError(f"--split: expected the split that was predicted, one of {', '.join(known)}")
    return fits[0]


def _described(facts: dict[str, Any]) -> str:
    counts = [counted(facts[key], key.removesuffix("s")) for key in ("poses", "images") if facts[key]]
    return ", ".join([f"{facts['kind']} of {counted(len(facts['sequences']), 'sequence')}", *counts])


def _other_runs(found: Found, run: int) -> str:
    """Say which runs are not sent, and where they would count; empty if there is one alone."""
    others = [number for number in found.runs if number != run]
    if not others and not found.failed:
        return ""
    note = f"run {run} alone is sent" + (f", not run {listed(map(str, others))} (--run)" if others else "")
    if found.scored:
        note += "; `leaderboard add` puts the mean of all on a board"
    return note + (f", with run {listed(map(str, found.failed))}, which failed" if found.failed else "")


def _unchanged(sent: dict[str, Any], given: dict[str, str]) -> str:
    """Say which of the texts given now an earlier submission of the same files does not have; empty if there is none.
    Those left out now are no change."""
    kept = {"summary": sent["summary"], "address": sent["url"]}
    odd = [key for key, text in given.items() if text.strip() not in ("", kept[key])]
    if not odd:
        return ""
    kept_as = "is unchanged" if len(odd) == 1 else "are unchanged"
    return f"these files were submitted on {sent['created']} already: the {' and '.join(odd)} given then {kept_as}"


def _before(found: dict[str, Any]) -> str:
    return f", {found['queued_before']} ahead in the queue" if found.get("queued_before") else ""


def _show(sent: dict[str, Any], as_json: bool) -> None:
    """Print the outcome of a submission to stdout; exit with status 1 where it failed or was withdrawn."""
    if as_json:
        echo(json.dumps(sent, indent=2))
    else:
        echo(
            f"{sent['method']} on {sent['split']}: {sent['state']}" + (": " + sent["reason"] if sent["reason"] else "")
        )
        for key, value in sent.get("score", {}).items():
            echo(f"  {key}: {'no value' if value is None else format(value, '.4g')}")
        for sequence, failure in sent.get("failures", {}).items():
            echo(f"  {sequence}: {failure}")
        if sent["state"] == "withdrawn":
            echo("  these files stay withdrawn under this name: to have them scored again, give another --method")
        elif sent["published"]:
            echo(f"  published: {sent['published']}")
        elif sent["state"] == "done":
            echo("  private until it is published: the same command with --publish does so")
    if sent["state"] in ("failed", "withdrawn"):
        sys.exit(OysterbenchError.exit_code)
