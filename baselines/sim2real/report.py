"""The table as text and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from oysterbench.core.page import page
from oysterbench.evaluate.statistics import Interval
from oysterbench_baselines.sim2real.plot import plot
from oysterbench_baselines.sim2real.table import Row

HEADINGS = ("training", "real images", "seeds", "IoU", "gain in IoU", "of clips", "AP", "AP50", "count MAE")


def lines(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """The cells of the table, a tuple for each row, under `HEADINGS`."""
    return [
        (
            row.variant,
            str(row.images) if row.seeds else "",
            str(len(row.seeds)) if row.seeds else "",
            f"{row.iou:.3f}{_bracket(row.interval)}",
            "" if row.gain is None else f"{row.gain:+.3f}{_bracket(row.gain_interval, '+')}",
            ", ".join(f"{clip} {value:.3f}" for clip, value in row.by_clip.items()),
            f"{row.means['ap_mask']:.3f}",
            f"{row.means['ap50_mask']:.3f}",
            f"{row.means['count_mae']:.1f}",
        )
        for row in rows
    ]


def _bracket(interval: Interval | None, sign: str = "") -> str:
    return f" [{interval.low:{sign}.3f}, {interval.high:{sign}.3f}]" if interval is not None and interval.known else ""


def markdown(rows: Sequence[Row]) -> str:
    """For a README."""
    text = ["| " + " | ".join(HEADINGS) + " |", "|" + "---|" * len(HEADINGS)]
    return "\n".join(text + ["| " + " | ".join(cells) + " |" for cells in lines(rows)]) + "\n"


def report(rows: Sequence[Row], remarks: Sequence[str]) -> str:
    """An HTML page."""
    head = "".join(f"<th>{escape(word)}</th>" for word in HEADINGS)
    body = "".join(
        "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell, tag in zip(cells, ("th", *["td"] * 8), strict=True))
        for cells in lines(rows)
    )
    said = "".join(f"<p>{escape(remark)}</p>" for remark in remarks)
    return page(
        "What rendered images are worth",
        f'<h1>What rendered images are worth</h1>{said}<div class="card">{plot(rows)}</div>'
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>',
    )
