"""The command that compares results: parse, call, print. `cli.main` adds it."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import TYPE_CHECKING

import click

from oysterbench.cli.echo import echo, message
from oysterbench.cli.outputs import Outputs, output_options, print_table

if TYPE_CHECKING:
    from oysterbench.results.records import ResultRecord

PROVIDERS = "oysterbench.results"
"""Entry-point group of functions (text, split or None) -> results that the text names, or None; one finds those of
leaderboards."""


@click.command("compare", short_help="Compare results: ranks, ties, which is better where.")
@click.argument("results", metavar="[LABEL=]RESULT...", nargs=-1, required=True)
@click.option("--track", help="Only results of this track, such as slam.")
@click.option("--split", help="Only results on this split.")
@output_options
def compare_command(results: tuple[str, ...], track: str | None, split: str | None, outputs: Outputs) -> None:
    """Compare results: whether they differ, where, and by how much.

    \b
    Examples:
      oysterbench compare ours/results.json theirs/results.json
      oysterbench compare monday=run1 tuesday=run2     the methods of a file, with a label
      oysterbench compare gtsam_vi gtsam_full --split slam-val     methods on the leaderboard
      oysterbench compare unet colour --track segmentation         one track of several
      oysterbench compare ours/results.json 3f9c21ab   with a record, by the start of its digest
      oysterbench compare run1 run2 --json
      oysterbench compare run1 run2 --report compare.html --tex table.tex

    RESULT is a file that `oysterbench eval` or `run` wrote, a folder that holds results.json, a method on the
    leaderboard, or a record's digest (8 digits or more). Beside files, a method's results are those of the files'
    tracks and splits.

    Methods are ranked by their score over the sequences that all of them were run on. A rank is 1 + the number of
    methods that are significantly better (95 %), and at least the rank of any placed above. Results of different
    splits, evaluators or settings are shown in separate tables.
    """
    from oysterbench.core.errors import ResultError
    from oysterbench.core.names import listed
    from oysterbench.evaluate.metrics import TRACKS
    from oysterbench.results.named import named_results
    from oysterbench.results.records import dump
    from oysterbench.results.remarks import remarks

    def find(text: str) -> list[ResultRecord] | None:
        return _provided(text, split)

    given = named_results(results, find)
    records = [one for one in given if track in (None, one.track) and split in (None, one.split)]
    order = {name: place for place, name in enumerate(TRACKS)}  # maps of dives after the paths they are made along
    records.sort(key=lambda one: order.get(one.track, len(order)))
    if not records:
        asked = " ".join([*([f"of the track {track}"] if track else []), *([f"on {split}"] if split else [])])
        there = dict.fromkeys(f"{one.track} on {one.split or 'own data'}" for one in given)
        raise ResultError(f"expected results {asked}, got {listed(there)}")
    from oysterbench.report import SlamRun, comparison_tables, results_tables  # slow to load
    from oysterbench.results.comparison import as_plain, boards

    found = boards(records)
    for path in outputs.write([SlamRun(record) for record in records]):
        message(f"written: {path}")
    if outputs.as_json:
        echo(dump({"remarks": remarks(found), "comparisons": [as_plain(board) for board in found]}))
    elif not outputs.on_stdout:
        for table in comparison_tables(records) or results_tables(records):
            print_table(table)


def _provided(text: str, split: str | None) -> list[ResultRecord] | None:
    """Results that a text other than a file names, from the first installed provider that knows it; else None."""
    for point in sorted(entry_points(group=PROVIDERS), key=lambda point: point.name):
        try:
            provider = point.load()
        except ModuleNotFoundError:  # it needs an extra that is not installed
            continue
        if (found := provider(text, split)) is not None:
            return list(found)
    return None
