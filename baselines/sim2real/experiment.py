"""The experiment: runs its cells one by one, skipping those already finished, and makes the table of all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

from oysterbench.annotations import LabelledSet
from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import LabelError
from oysterbench.core.locks import locked
from oysterbench.report.renderers import markdown_table
from oysterbench.report.table import Table
from oysterbench.results.records import ResultRecord, write_results
from oysterbench_baselines.sim2real.data import Real, real_data, site_data, sites_of
from oysterbench_baselines.sim2real.report import report, table_of
from oysterbench_baselines.sim2real.scoring import WHOLE, score
from oysterbench_baselines.sim2real.settings import Cell, ExperimentSettings, cells_of
from oysterbench_baselines.sim2real.sites import SiteRow, site_rows, sites_table
from oysterbench_baselines.sim2real.table import VariantRow, variants
from oysterbench_baselines.sim2real.trivial import TRIVIAL, predictions, settings_of
from oysterbench_baselines.sim2real.work import (
    LOCK,
    RESULT,
    Bench,
    Source,
    finished,
    known_records,
    records_of,
    run_cell,
)

Bar = Callable[[str, str], AbstractContextManager[Callable[[int, int], None]]]
"""Creates a progress bar from its title and unit."""


def run(
    labelled: LabelledSet,
    synthetic: Mapping[str, Source],
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
    remarks = list(_remarks(labelled, real, settings.sizes))
    for remark in remarks:
        echo(remark)
    bench = Bench(real, synthetic, settings, device)
    cells = [cell for cell in cells_of(tuple(synthetic), settings) if (cell.size or 0) <= len(real.train)]
    records = _records(bench, cells, out / "cells", train, bar, echo)
    rows = variants(records, settings.block)
    write_results(out / RESULT, records)
    write_atomically(out / "table.md", markdown_table(table_of(rows)).encode())
    write_atomically(out / "report.html", report(rows, remarks).encode())
    show(table_of(rows))
    _tell_end([out / "cells" / cell.folder for cell in cells], out / "report.html", echo)
    return rows


def run_sites(
    labelled: LabelledSet,
    synthetic: Mapping[str, Source],
    settings: ExperimentSettings,
    out: Path,
    device: str,
    train: bool,
    bar: Bar,
    echo: Callable[[str], None],
    show: Callable[[Table], None],
) -> list[SiteRow]:
    """Run all cells with each site in turn as the test set, trained on all real images of the others; write table.md
    and results.json into `out`, and the cells of a site into a folder of its name. Raises LabelError for a single
    site."""
    with bar("looking for clips of one site", "clips") as progress:
        sites = sites_of(labelled, settings.similarity, progress)
    if len(sites) < 2:
        raise LabelError(f"{labelled.name}: expected clips of two sites at least, got {', '.join(sites)}")
    settings = settings.for_other_sites()
    records: dict[str, list[ResultRecord]] = {}
    folders: list[Path] = []
    remarks = []
    for site, clips in sites.items():
        with bar(f"{site}: looking for near duplicates", "images") as progress:
            real = site_data(labelled, clips, settings.similarity, progress)
        remarks.append(
            f"{site}: {len(real.test)} images of {', '.join(clips)}, {len(real.train)} of others to train on"
        )
        echo(remarks[-1])
        bench = Bench(real, synthetic, settings, device, out / "synthetic")
        cells = cells_of(tuple(synthetic), settings)
        records[site] = _records(bench, cells, out / site, train, bar, echo)
        folders += [out / site / cell.folder for cell in cells]
    rows = site_rows(records, settings.block)
    table = sites_table(rows, remarks)
    write_results(out / RESULT, [record for found in records.values() for record in found])
    write_atomically(out / "table.md", markdown_table(table).encode())
    show(table)
    _tell_end(folders, out / "table.md", echo)
    return rows


def _records(
    bench: Bench, cells: list[Cell], place: Path, train: bool, bar: Bar, echo: Callable[[str], None]
) -> list[ResultRecord]:
    """Records of the trivial methods and of the cells in a folder; with `train`, unfinished cells are trained first."""
    records = _trivial(bench, place)
    left = [cell for cell in cells if finished(bench, cell, place / cell.folder) is None]
    if train and left:
        total, before = sum(bench.steps(cell) for cell in left), 0
        with bar(f"{len(left)} of {len(cells)} trainings", "steps") as progress:
            progress(0, total)
            for cell in left:
                folder = place / cell.folder
                with locked(folder / LOCK, wait=False) as mine:
                    if mine:
                        found = run_cell(bench, cell, folder, partial(_told, progress, before, total))
                        echo(f"{folder.name}: {_summary(found)}")
                before += bench.steps(cell)
                progress(before, total)
    for cell in cells:  # including those that other processes have finished meanwhile
        records += finished(bench, cell, place / cell.folder) or []
    return records


def _tell_end(folders: list[Path], written: Path, echo: Callable[[str], None]) -> None:
    missing = sum(not (folder / RESULT).is_file() for folder in folders)
    echo(
        f"{len(folders) - missing} of {len(folders)} trainings are finished"
        + ("; the same command resumes" * bool(missing))
    )
    echo(f"written: {written}")


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


def _remarks(labelled: LabelledSet, real: Real, sizes: Sequence[int]) -> Iterator[str]:
    """Remarks on the data that a reader of the table should know. sizes: numbers of real images that are asked for."""
    yield (
        f"{labelled.name}: {len(real.train)} images to train on ({', '.join(real.train.clips)}), {len(real.test)} to "
        f"test on ({', '.join(real.test.clips)})"
    )
    if larger := [size for size in sizes if size > len(real.train)]:
        yield (
            f"left out: size{'s' * (len(larger) > 1)} {', '.join(map(str, larger))}, as there are {len(real.train)} "
            "real images to train on"
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
