"""The experiment: its cells one by one, those that are finished already left as they are, and the table of all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

from oysterbench.annotations import LabelledSet
from oysterbench.core.files import locked, write_atomically
from oysterbench.report.renderers import markdown_table
from oysterbench.report.table import Table
from oysterbench.results.records import ResultRecord, write_results
from oysterbench_baselines.sim2real.data import Real, real_data
from oysterbench_baselines.sim2real.report import report, table_of
from oysterbench_baselines.sim2real.scoring import WHOLE, score
from oysterbench_baselines.sim2real.settings import ExperimentSettings, cells_of
from oysterbench_baselines.sim2real.table import VariantRow, variants
from oysterbench_baselines.sim2real.trivial import TRIVIAL, predictions, settings_of
from oysterbench_baselines.sim2real.work import LOCK, RESULT, Bench, finished, known_records, records_of, run_cell

Bar = Callable[[str, str], AbstractContextManager[Callable[[int, int], None]]]
"""A progress bar by its title and unit."""


def run(
    labelled: LabelledSet,
    synthetic: Mapping[str, LabelledSet],
    settings: ExperimentSettings,
    out: Path,
    hold_out: tuple[str, ...],
    device: str,
    train: bool,
    bar: Bar,
    echo: Callable[[str], None],
    show: Callable[[Table], None],
) -> list[VariantRow]:
    """Run all cells that are not finished, and write table.md, report.html and results.json into `out`."""
    with bar("looking for near duplicates", "images") as progress:
        real = real_data(labelled, hold_out, settings.similarity, progress)
    remarks = list(_remarks(labelled, real))
    for remark in remarks:
        echo(remark)
    bench = Bench(real, synthetic, settings, device)
    cells = [cell for cell in cells_of(tuple(synthetic), settings) if (cell.size or 0) <= len(real.train)]
    records = _trivial(bench, out / "cells")
    left = [cell for cell in cells if finished(bench, cell, out / "cells" / cell.folder) is None]
    if train and left:
        total, before = sum(settings.fit_of(cell).steps for cell in left), 0
        with bar(f"{len(left)} of {len(cells)} trainings", "steps") as progress:
            progress(0, total)
            for cell in left:
                folder = out / "cells" / cell.folder
                with locked(folder / LOCK, wait=False) as mine:
                    if mine:
                        found = run_cell(bench, cell, folder, partial(_told, progress, before, total))
                        echo(f"{folder.name}: {_summary(found)}")
                before += settings.fit_of(cell).steps
                progress(before, total)
    for cell in cells:  # also what others have finished meanwhile
        records += finished(bench, cell, out / "cells" / cell.folder) or []
    rows = variants(records, settings.block)
    write_results(out / RESULT, records)
    write_atomically(out / "table.md", markdown_table(table_of(rows)).encode())
    write_atomically(out / "report.html", report(rows, remarks).encode())
    show(table_of(rows))
    missing = sum(not (out / "cells" / cell.folder / RESULT).is_file() for cell in cells)
    echo(
        f"{len(cells) - missing} of {len(cells)} trainings are finished"
        + ("; the same command goes on" * bool(missing))
    )
    echo(f"written: {out / 'report.html'}")
    return rows


def _told(progress: Callable[[int, int], None], before: int, total: int, done: int, _: int) -> None:
    progress(before + done, total)


def _trivial(bench: Bench, cells: Path) -> list[ResultRecord]:
    records = []
    for kind in TRIVIAL:
        method, folder = kind(), cells / kind.name
        identity = {"method": kind.name, "settings": settings_of(method), "test": bench.test_digest}
        known = known_records(folder, identity)
        if known is None:
            known = records_of(score(bench.truth, predictions(method, bench.truth)), kind.name, bench, None, identity)
            write_results(folder / RESULT, known)
        records += known
    return records


def _remarks(labelled: LabelledSet, real: Real) -> Iterator[str]:
    """What a reader of the table should know of the data."""
    yield (
        f"{labelled.name}: {len(real.train)} images to train on ({', '.join(real.train.clips)}), {len(real.test)} to "
        f"test on ({', '.join(real.test.clips)})"
    )
    for leak in real.leaks:
        yield (
            f"left out: training image {leak.one} shows what test image {leak.other} shows (correlation "
            f"{leak.correlation:.2f})"
        )


def _summary(records: list[ResultRecord]) -> str:
    whole = next(record for record in records if record.sequence == WHOLE)
    clips = ", ".join(f"{r.sequence} {r.metrics['iou']:.3f}" for r in records if r is not whole)
    return f"IoU {whole.metrics['iou']:.3f} ({clips}), AP {whole.metrics['ap_mask']:.3f}"
