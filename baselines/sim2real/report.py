"""The table of all trainings, and the page that shows it with its plot."""

from __future__ import annotations

from collections.abc import Sequence

from oysterbench.core.html import render
from oysterbench.evaluate.statistics import Interval
from oysterbench.report.renderers import html_table
from oysterbench.report.table import Column, Estimate, Table, TableRow
from oysterbench_baselines.sim2real.plot import plot
from oysterbench_baselines.sim2real.table import VariantRow

TITLE = "What rendered images add"

COLUMNS = (
    Column("training", "training"),
    Column("real_images", "real images", kind="number"),
    Column("seeds", "seeds", kind="number"),
    Column("iou", "IoU", kind="estimate", digits=3, better="higher"),
    Column("gain", "gain in IoU", kind="estimate", digits=3, signed=True),
    Column("clips", "of clips"),
    Column("ap_mask", "AP", kind="number", digits=3, better="higher"),
    Column("ap50_mask", "AP50", kind="number", digits=3, better="higher"),
    Column("count_mae", "count MAE", kind="number", digits=1, better="lower"),
)


def table_of(rows: Sequence[VariantRow], remarks: Sequence[str] = ()) -> Table:
    """Table with a row for each kind of training; remarks: shown below it."""
    return Table(TITLE, COLUMNS, tuple(map(_row, rows)), tuple(remarks))


def _row(row: VariantRow) -> TableRow:
    unknown = Interval(float("nan"), float("nan"), "")
    return TableRow(
        (
            row.variant,
            row.images if row.seeds else None,
            len(row.seeds) or None,
            Estimate(row.iou, row.interval),
            None if row.gain is None else Estimate(row.gain, row.gain_interval or unknown),
            ", ".join(f"{clip} {value:.3f}" for clip, value in row.by_clip.items()),
            *(row.means[column.key] for column in COLUMNS[-3:]),
        )
    )


def report(rows: Sequence[VariantRow], remarks: Sequence[str]) -> str:
    """Render the table and the plot as an HTML page."""
    from markupsafe import Markup

    context = {"title": TITLE, "table": Markup(html_table(table_of(rows, remarks))), "plot": Markup(plot(rows))}
    return render("sim2real.html", context, "oysterbench_baselines.sim2real")
