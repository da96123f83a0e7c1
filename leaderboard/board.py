"""What a board shows: its name, its rows, a page of them. `index_writer.py` makes them, `index.py` finds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol

from oysterbench.evaluate.detection import DetectionSettings
from oysterbench.evaluate.segmentation import SegmentationSettings
from oysterbench.evaluate.slam import SlamSettings
from oysterbench.results.records import plain

if TYPE_CHECKING:
    from oysterbench_leaderboard.store import RecordStore

State = Literal["current", "superseded", "withdrawn"]

DEFAULTS = {"slam": SlamSettings(), "segmentation": SegmentationSettings(), "detection": DetectionSettings()}
"""Track -> settings of its evaluator, where these can be chosen."""

LEAST_DIGITS = 8
"""Of a record's digest that is given short."""


@dataclass(frozen=True)
class BoardInfo:
    """A board: records whose numbers may be set against each other.

    id:        16 hex digits (`Record.board`)
    settings:  of the evaluator
    metric:    key of the metric that ranks; columns: keys that stand beside it in a table, in order
    sequences: of the split, by name: those that any ranked record has. A record that lacks one failed there
    entries:   current records
    updated:   creation of the newest of them
    newest:    whether it is not former, and no board of the same track, split and recipe has a later evaluator; the
               others are history
    former:    whether the split has records of a later recipe: what was run on then is not what is there now
    """

    id: str
    track: str
    split: str
    split_digest: str
    evaluator_version: str
    settings: Mapping[str, Any]
    metric: str
    columns: tuple[str, ...]
    sequences: tuple[str, ...]
    entries: int
    updated: str
    newest: bool
    former: bool = False

    @property
    def scored_by(self) -> str:
        """The evaluator, with the settings that are not its defaults: what tells boards of one split apart."""
        return ", ".join(
            [self.evaluator_version, *(f"{key} = {value}" for key, value in self.changed_settings.items())]
        )

    @property
    def has_defaults(self) -> bool:
        """Whether it is known which settings are the evaluator's defaults."""
        return self.track in DEFAULTS

    @property
    def changed_settings(self) -> dict[str, Any]:
        """The settings that are not the evaluator's defaults; none where it is not known what these are."""
        defaults = plain(asdict(DEFAULTS[self.track])) if self.track in DEFAULTS else self.settings
        return {key: value for key, value in self.settings.items() if defaults.get(key) != value}


@dataclass(frozen=True)
class Row:
    """A record on its board.

    place:     by the ranking metric's mean alone; equal means share one. None without a value, not
               current, or self-reported
    rank:      by significance (`oysterbench.results.standings`); None with too few sequences, or without a place
    tied:      whether another record has the same rank; the same place where there are no ranks
    score:     mean of the ranking metric over all sequences of the board; low, high: its interval, None where there are
               too few sequences
    data_set:  the ranking metric over all sequences at once, where the record knows it, such as COCO's AP: it is shown,
               and does not rank, as a paired comparison needs a value on each sequence
    coverage:  mean over sequences, for tracks that have such a thing
    metrics:   means of the columns, coverage among them where it is one; of errors the medians over the sequences that
               are not lost; None where there is none
    failures:  runs that failed, and sequences that were not answered
    lost:      sequences of the board that are lost (`oysterbench.results.lost`), the unanswered among them; None where
               the track has no such thing
    sensors, mode: what the method says that it uses, and "online" or "offline"; code, paper: where its program is, and
               what it is described in; each empty where it says nothing
    machine:  that its speeds were measured on; empty where it does not say, or had several
    """

    digest: str
    board: str
    method: str
    team: str
    tier: str
    url: str
    summary: str
    created: str
    supersedes: str
    state: State
    place: int | None
    rank: int | None
    tied: bool
    score: float | None
    low: float | None
    high: float | None
    data_set: float | None
    coverage: float | None
    metrics: Mapping[str, float | None]
    sequences: int
    runs: int
    failures: int
    lost: int | None = None
    sensors: str = ""
    mode: str = ""
    code: str = ""
    paper: str = ""
    machine: str = ""


@dataclass(frozen=True)
class Query:
    """What is asked of a board.

    sort:     "rank", "method", "team", "created", "score", "data_set", "coverage", "lost", or a column's key;
              descending: the other way round. Records without the value are last either way
    text:     in method or team, whatever the case; tiers: none for all
    states:   which records; superseded and withdrawn ones have no place
    page:     from 1; size: rows of a page
    """

    sort: str = "rank"
    descending: bool = False
    text: str = ""
    tiers: tuple[str, ...] = ()
    states: tuple[State, ...] = ("current",)
    page: int = 1
    size: int = 50


@dataclass(frozen=True)
class BoardPage:
    """Rows of a board that a query asks for; total: how many there are on all pages."""

    board: BoardInfo
    query: Query
    rows: tuple[Row, ...]
    total: int

    @property
    def pages(self) -> int:
        return max(1, -(-self.total // self.query.size))


class BoardReader(Protocol):
    """What every reader may ask: of a database (`index.BoardIndex`), or of the records in memory."""

    @property
    def store(self) -> RecordStore: ...

    @property
    def revision(self) -> str: ...

    def boards(self, track: str | None = None) -> list[BoardInfo]: ...

    def page(self, board: str, query: Query) -> BoardPage: ...

    def row(self, digest: str) -> Row: ...

    def method(self, method: str, team: str | None = None) -> list[Row]: ...

    def methods(self) -> list[tuple[str, str, int]]: ...

    def sequence_means(self, digest: str) -> dict[str, dict[str, float | None]]: ...

    def problems(self) -> dict[str, str]: ...


@dataclass(frozen=True)
class Literature:
    """A number that others reported on other data: never ranked with ours.

    metric: in words, as its source defines it; data: what it was measured on; source: where it stands
    """

    track: str
    method: str
    metric: str
    value: str
    data: str
    source: str
    url: str = ""
    note: str = field(default="")
