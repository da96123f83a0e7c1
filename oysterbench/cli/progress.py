"""Progress of running work, on stderr: a bar for each run on a terminal, otherwise a line at every tenth."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from oysterbench.cli.echo import message
from oysterbench.cli.render import frames_bar, plain_progress
from oysterbench.core.text import printable

if TYPE_CHECKING:
    from rich.progress import TaskID

    from oysterbench.methods.run_output import OnOutput, RunOutput
    from oysterbench.simulation.generate import Progress

LATE_S = 2.0  # no progress is shown for work that takes less
QUIET_S = 30.0  # minimum interval between two lines of a run's other output
BAR_WIDTH = 16  # characters


@contextmanager
def runs_shown() -> Iterator[OnOutput]:
    """Yield a function to be called with the output of runs; nothing is shown before its first call."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.table import Column

    console = Console(stderr=True)
    if not console.is_terminal:
        yield plain_runs()
        return
    title = TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis"))
    rest = Column(no_wrap=True, overflow="ellipsis", ratio=1)
    said = TextColumn("{task.fields[said]}", markup=False, table_column=rest)
    times = (TimeElapsedColumn(), TextColumn("so far,"), TimeRemainingColumn(), TextColumn("left"))
    columns = (title, BarColumn(BAR_WIDTH), said, *times)
    bars = Progress(*columns, console=console, redirect_stdout=False, transient=True, expand=True, refresh_per_second=2)
    tasks: dict[str, TaskID] = {}

    def tell(outputs: Mapping[str, RunOutput]) -> None:
        for name in tasks.keys() - outputs.keys():
            bars.remove_task(tasks.pop(name))
        for name, one in outputs.items():
            if name not in tasks:
                tasks[name] = bars.add_task(printable(name), total=None, said="")
            if one.total:
                bars.update(tasks[name], total=one.total, completed=one.done, said=f"{one.done} of {one.total}")
            elif bars.tasks[bars.task_ids.index(tasks[name])].total is None:  # else only progress is shown
                bars.update(tasks[name], said=printable(one.line))
        bars.start()

    try:
        yield tell
    finally:
        bars.stop()


def plain_runs() -> OnOutput:
    """Return a function that prints lines on stderr: each run's progress at every tenth and every few minutes, or its
    other output, not too often."""
    bars: dict[str, tuple[Progress, RunOutput]] = {}
    told: dict[str, tuple[float, str]] = {}

    def tell(outputs: Mapping[str, RunOutput]) -> None:
        for name in bars.keys() - outputs.keys():
            del bars[name]
        for name, one in outputs.items():
            at, line = told.setdefault(name, (time.monotonic(), ""))
            if one.total:
                show, before = bars.get(name, (plain_progress(name, ""), one))
                if one.done < before.done:  # another pass over the images
                    show = plain_progress(name, "")
                bars[name] = show, one
                show(one.done, one.total)
            elif name not in bars and one.line != line and time.monotonic() >= at + QUIET_S:
                told[name] = time.monotonic(), one.line
                message(f"{name}: {one.line}")

    return tell


@contextmanager
def bytes_bar(title: str) -> Iterator[Progress]:
    """Progress bar in bytes on a terminal, otherwise a line at every tenth; both on stderr."""
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        told = -1

        def tell(done: int, total: int) -> None:
            nonlocal told
            if (tenth := 10 * done // max(total, 1)) > told:
                told = tenth
                unit, size = ("MB", 1e6) if total >= 1e6 else ("kB", 1e3)
                message(f"{title}: {done / size:.1f} of {total / size:.1f} {unit}")

        yield tell
        return
    columns = (TextColumn(title), BarColumn(), DownloadColumn(), TransferSpeedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def late_bar(title: str, unit: str) -> Iterator[Progress]:
    """Progress bar like `frames_bar` that appears only after `LATE_S`."""
    began = time.monotonic()
    with frames_bar(title, unit) as progress:

        def tell(done: int, total: int) -> None:
            if time.monotonic() >= began + LATE_S:
                progress(done, total)

        yield tell


@contextmanager
def late_bars(title: str) -> Iterator[Callable[[str, int, int], None]]:
    """A `late_bar` for each unit that is reported, one after the other."""
    with ExitStack() as stack:
        units = list[str]()
        shown: Progress = lambda done, total: None  # noqa: E731

        def tell(unit: str, done: int, total: int) -> None:
            nonlocal shown
            if unit not in units[-1:]:
                stack.close()
                units.append(unit)
                shown = stack.enter_context(late_bar(title, unit))
            shown(done, total)

        yield tell
