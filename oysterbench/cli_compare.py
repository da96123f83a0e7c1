"""The command that sets results against each other: parse, call, print. `cli` takes it in."""

from __future__ import annotations

import click

from oysterbench.cli_outputs import Outputs, output_options, print_rich


@click.command("compare", short_help="Set results against each other: ranks, ties, who is better where.")
@click.argument("results", metavar="[LABEL=]RESULT...", nargs=-1, required=True)
@output_options
def compare_command(results: tuple[str, ...], outputs: Outputs) -> None:
    """Compare results that `oysterbench eval` wrote: JSON files, or the folders that hold results.json.

    \b
    Examples:
      oysterbench compare ours/results.json theirs/results.json
      oysterbench compare monday=run1 tuesday=run2     the methods of a file under a label
      oysterbench compare run1 run2 --json
      oysterbench compare run1 run2 --report compare.html --tex table.tex

    Methods are ranked by their score over the sequences that all of them were run on; those that cannot be told apart
    at 95 % share a rank. Results of different splits, evaluators or settings are kept apart, in tables of their own.
    """
    from oysterbench.comparison import as_plain, boards, remarks
    from oysterbench.report import SlamRun, comparison_tables, results_tables, terminal_table
    from oysterbench.results import dump, labelled_results

    records = labelled_results(results)
    found = boards(records)
    for path in outputs.write([SlamRun(record) for record in records]):
        click.echo(f"written: {path}", err=True)
    if outputs.as_json:
        click.echo(dump({"remarks": remarks(found), "comparisons": [as_plain(board) for board in found]}))
    elif not outputs.on_stdout:
        for table in comparison_tables(records) or results_tables(records):
            print_rich(terminal_table(table))
