"""What is shown while something long goes on: a bar in a terminal or a notebook, and lines elsewhere; on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from oysterbench.core.text import printable

Progress = Callable[[int, int], None]
"""Called with what is done, and what there is to do."""

TELL_S = 300.0
"""Between two lines on the progress, at most."""


def say(text: object) -> None:
    """A message to the user, on stderr."""
    print(printable(str(text)), file=sys.stderr, flush=True)


@contextmanager
def frames_bar(title: str, unit: str = "frames") -> Iterator[Progress]:
    """A progress bar in a terminal or a notebook, else a line at every tenth or few minutes; with the time left.

    Nothing is shown before it is told of anything.
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
    # In Jupyter a bar is drawn by ipywidgets, where there are such.
    if not console.is_terminal and not (console.is_jupyter and find_spec("ipywidgets")):
        yield plain_progress(title, unit)
        return
    columns = (TextColumn(title), BarColumn(), MofNCompleteColumn(), TextColumn(unit))
    with Progress(*columns, TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(), console=console) as bar:

        def update(done: int, total: int) -> None:
            if not bar.tasks:  # begun with what was there before, so that it does not count as fast work
                bar.add_task(title, total=total, completed=done)
            bar.update(bar.tasks[0].id, completed=done, total=total)

        yield update


def plain_progress(title: str, unit: str = "frames") -> Progress:
    """Progress as lines: at every tenth, and every few minutes."""
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
    """A time in words: 50 s, 12 min, 3 h 20 min.

    >>> in_words(50), in_words(720), in_words(12000)
    ('50 s', '12 min', '3 h 20 min')
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
