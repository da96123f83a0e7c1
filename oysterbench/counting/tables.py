"""Tables that people bring: a number or several for each picture, as corners of quadrats, or altitudes."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from oysterbench.core.errors import LabelError
from oysterbench.counting.sources import Source

PICTURE = "picture"


@dataclass(frozen=True)
class PictureTable:
    """Numbers by the name of a picture, of a frame of a video, or of a video, which is for all its frames.

    unused: rows that name none of the sources
    """

    path: Path
    rows: Mapping[str, tuple[float, ...]]
    unused: tuple[str, ...] = ()

    def of(self, source: Source, name: str) -> tuple[float, ...] | None:
        """Of a picture or frame of a source, if there are any."""
        return self.rows.get(name, self.rows.get(source.name))


def read_table(path: Path, columns: Sequence[str], sources: Sequence[Source]) -> PictureTable:
    """A CSV of `picture` and further columns of numbers; with semicolons, commas may be decimal, as spreadsheets write.

    A picture is called by its name, as pictures.csv has it, or by that of its file where only one has it; a frame by
    VIDEO/NUMBER. Raises LabelError by line.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise LabelError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise LabelError(f"{path}: expected a table as text in UTF-8 (CSV)") from None
    semicolons = ";" in text.partition("\n")[0]
    lines = list(csv.reader(io.StringIO(text, newline=""), delimiter=";" if semicolons else ","))
    wanted = [PICTURE, *columns]
    head = [word.strip() for word in lines[0]] if lines else []
    if missing := [key for key in wanted if key not in head]:
        raise LabelError(f"{path}:1: expected the columns {','.join(wanted)}, missing: {', '.join(missing)}")
    places = [head.index(key) for key in wanted]
    rows: dict[str, tuple[float, ...]] = {}
    unused = []
    for number, line in enumerate(lines[1:], start=2):
        if not any(word.strip() for word in line):
            continue
        where = f"{path}:{number}"
        if len(line) < len(head):
            raise LabelError(f"{where}: expected {len(head)} values, got {len(line)}")
        said, *values = (line[place].strip() for place in places)
        name = _named(said, sources, where)
        if name is None:
            unused.append(said)
            continue
        if name in rows:
            raise LabelError(f"{where}: {said} is listed twice")
        rows[name] = tuple(_number(v.replace(",", ".") if semicolons else v, where) for v in values)
    return PictureTable(path, rows, tuple(unused))


def _named(said: str, sources: Sequence[Source], where: str) -> str | None:
    """The name by which the table's picture is known here; None where there is none."""
    frame_of = next((s for s in sources if s.video and said.startswith(f"{s.name}/")), None)
    if frame_of is not None:
        return said
    suffixed = {source.name: source.name + ("" if source.video else source.path.suffix) for source in sources}
    if exact := [name for name, whole in suffixed.items() if said in (name, whole)]:
        return exact[0]
    same = [source.name for source in sources if said in (source.path.name, source.path.stem)]
    if len(same) > 1:
        raise LabelError(f"{where}: {len(same)} pictures are called {said!r}: expected one of {', '.join(same[:4])}")
    return same[0] if same else None


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise LabelError(f"{where}: expected a number, got {text[:40]!r}")
    return value
