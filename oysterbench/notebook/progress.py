"""Progress of long operations: a bar in a terminal or a notebook, and lines elsewhere; on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from oysterbench.core.text import printable

Progress = Callable[[int, int], None]
"""Called with the amount done, and the total."""

TELL_S = 300.0
"""Longest time between two lines of progress, s."""


def say(text: object) -> None:
    """Print a message to the user on stderr."""
    print(printable(str(text)), file=sys.stderr, flush=True)


@contextmanager
def frames_bar(title: str, unit: str = "frames") -> Iterator[Progress]:
    """Show a progress bar in a terminal or a notebook, else a line at every tenth or few minutes; with the time left.

    Nothing is shown before the first call of the yielded function.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    # In Jupyter, ipywidgets draws the bar, where that is installed.
    if not console.is_terminal and not (console.is_jupyter and find_spec("ipywidgets")):
        yield plain_progress(title, unit)
        return
    columns = (TextColumn(title), BarColumn(), MofNCompleteColumn(), TextColumn(unit))
    with Progress(*columns, TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(), console=console) as bar:

        def update(done: int, total: int) -> None:
            if not bar.tasks:  # starts from what was there before, which must not count as fast work
                bar.add_task(title, total=total, completed=done)
            bar.update(bar.tasks[0].id, completed=done, total=total)

        yield update


def plain_progress(title: str, unit: str = "frames") -> Progress:
    """Report progress in lines: at every tenth, and every few minutes."""
    first, told, began, at = -1, -1, 0.0, 0.0

    def tell(done: int, total: int) -> None:
        nonlocal first, told, began, at
        now = time.monotonic()
        if first < 0:
            first, began = done, now
        tenth = 10 * done // max(total, 1)
        if tenth <= told and now < at + TELL_S:
            return
        told, at = tenth, now
        left = f", {in_words((now - began) * (total - done) / (done - first))} left" if first < done < total else ""
        say(f"{title}: {f'{done} of {total} {unit}'.rstrip()}{left}")

    return tell


def in_words(seconds: float) -> str:
    """A duration as text: 50 s, 12 min, 3 h 20 min.

    >>> in_words(50), in_words(720), in_words(12000)
    ('50 s', '12 min', '3 h 20 min')
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
