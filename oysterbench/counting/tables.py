"""Tables supplied by users: one or more numbers for each image, such as corners of quadrats, or altitudes."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from oysterbench.core.errors import LabelError
from oysterbench.core.text import composed, separator
from oysterbench.counting.sources import Source

IMAGE = "image"


@dataclass(frozen=True)
class PictureTable:
    """Numbers by the name of an image, of a frame of a video, or of a video, which apply to all its frames.

    unused: names in the table that match none of the sources
    """

    path: Path
    rows: Mapping[str, tuple[float, ...]]
    unused: tuple[str, ...] = ()

    def of(self, source: Source, name: str) -> tuple[float, ...] | None:
        """Numbers of an image or frame of a source; None if there are none."""
        return self.rows.get(name, self.rows.get(source.name))

    def besides(self, names: Collection[str]) -> tuple[str, ...]:
        """Names in the table, of sources or their frames, that are not among `names`."""
        return tuple(name for name in self.rows if name not in names)


def read_table(path: Path, columns: Sequence[str], sources: Sequence[Source]) -> PictureTable:
    """Read a CSV with the column `image` and further columns of numbers. Between semicolons or tabs, commas may
    be decimal, as spreadsheets write them.

    An image is identified by its name, as in images.csv, or by that of its file if it is unique; a frame by
    VIDEO/NUMBER. Raises LabelError naming the line.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise LabelError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise LabelError(f"{path}: expected a CSV table in UTF-8: in a spreadsheet, save it as 'CSV UTF-8'") from None
    mark = separator(text)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=mark)
    try:
        lines = list(reader)
    except csv.Error as error:
        raise LabelError(f"{path}:{reader.line_num}: cannot be read as CSV: {error}") from None
    wanted = [IMAGE, *columns]
    head = [word.strip() for word in lines[0]] if lines else []
    if missing := [key for key in wanted if key not in head]:
        raise LabelError(f"{path}:1: expected the columns {','.join(wanted)}, missing: {', '.join(missing)}")
    places = [head.index(key) for key in wanted]
    names = _Names(sources)
    rows: dict[str, tuple[float, ...]] = {}
    unused = []
    for number, line in enumerate(lines[1:], start=2):
        if not any(word.strip() for word in line):
            continue
        where = f"{path}:{number}"
        if len(line) < len(head):
            raise LabelError(f"{where}: expected {len(head)} values, got {len(line)}")
        said, *values = (line[place].strip() for place in places)
        name = names.find(said, where)
        if name is None:
            unused.append(said)
            continue
        if name in rows:
            raise LabelError(f"{where}: {said} is listed twice")
        rows[name] = tuple(_number(v if mark == "," else v.replace(",", "."), where) for v in values)
    return PictureTable(path, rows, tuple(unused))


class _Names:
    """Names that images and videos may have in a table. Letters with diacritics match whether they are one character or
    several, as in file names from macOS."""

    def __init__(self, sources: Sequence[Source]) -> None:
        self._own = {composed(one.name): one.name for one in sources}
        self._videos = {composed(one.name): one.name for one in sources if one.video}
        self._whole = {composed(one.name + one.path.suffix): one.name for one in sources if not one.video}
        self._files: dict[str, list[str]] = {}
        for one in sources:
            for called in {composed(one.path.name), composed(one.path.stem)}:
                self._files.setdefault(called, []).append(one.name)

    def find(self, said: str, where: str) -> str | None:
        """Return the name of the source or frame that is meant; None if there is none. Raises LabelError if several
        images have that name.

        An apostrophe before it is that of images.csv, which keeps spreadsheets from running names as formulas.
        """
        found = self._named(composed(said), where)
        return self._named(composed(said[1:]), where) if found is None and said.startswith("'") else found

    def _named(self, said: str, where: str) -> str | None:
        video, _, frame = said.rpartition("/")
        if video in self._videos and frame.isascii() and frame.isdigit():
            return f"{self._videos[video]}/{frame.lstrip('0').zfill(6)}"  # as `run.frame_name` writes it
        if exact := self._own.get(said) or self._whole.get(said):
            return exact
        same = self._files.get(said, [])
        if len(same) > 1:
            raise LabelError(f"{where}: {len(same)} images are called {said!r}: expected one of {', '.join(same[:4])}")
        return same[0] if same else None


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise LabelError(f"{where}: expected a number, got {text[:40]!r}")
    return value
