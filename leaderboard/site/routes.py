"""Every page of the site: its address, its query parameters, what makes it, and what its JSON holds."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from oysterbench.evaluate.statistics import Comparison
from oysterbench_leaderboard.boards.board import STATES, BoardInfo, Literature, Query, Row
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.pages.board import LONGEST_TEXT, MOST_ROWS, SIZES, board_page, parse_query
from oysterbench_leaderboard.site.pages.compare import compare_page
from oysterbench_leaderboard.site.pages.compare_several import MOST, records_compared, several_page
from oysterbench_leaderboard.site.pages.data import data_page, split_page
from oysterbench_leaderboard.site.pages.home import home_page
from oysterbench_leaderboard.site.pages.literature import literature_page
from oysterbench_leaderboard.site.pages.log import log_page
from oysterbench_leaderboard.site.pages.method import method_page
from oysterbench_leaderboard.site.pages.prose import about_page, submit_page
from oysterbench_leaderboard.site.pages.record import record_page
from oysterbench_leaderboard.site.paths import SLUG
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.record import TIERS
from oysterbench_leaderboard.storage.store import StatusChange

Given = Mapping[str, str]
Objects = list[dict[str, Any]]
Asked = Mapping[str, Sequence[str]]

PATTERNS = {
    "track": SLUG,
    "split": SLUG,
    "method": SLUG,
    "board": "[0-9a-f]{16}",
    "digest": "[0-9a-f]{8,64}",
}
"""Part of an address -> regular expression that it must match."""


@dataclass(frozen=True)
class Parameter:
    """Parameter of a query. schema: as in JSON Schema."""

    name: str
    about: str
    schema: Mapping[str, Any]
    required: bool = False


@dataclass(frozen=True)
class Route:
    """Route of a page. path: with the parts of `PATTERNS` in braces, without suffix.

    ask:     parses the query; make: makes the page
    settle:  returns what the parsed query comes to on this site, by which the page is cached; None where that is the
             parsed query itself
    answers: keys of its JSON -> their types
    """

    path: str
    summary: str
    make: Callable[[Site, Given, Any], Page]
    answers: Mapping[str, Any]
    ask: Callable[[Asked], Hashable] = lambda asked: ()
    query: tuple[Parameter, ...] = ()
    settle: Callable[[Site, Any], Hashable] | None = None

    @property
    def parts(self) -> list[str]:
        """Names of the parts in braces."""
        return [part[1:-1] for part in self.path.split("/") if part.startswith("{")]


def _choice(values: Sequence[str]) -> dict[str, Any]:
    return {"type": "array", "items": {"type": "string", "enum": list(values)}}


BOARD_QUERY = (
    Parameter("sort", "rank, method, team, created, data_set, or the key of a metric of the board", {"type": "string"}),
    Parameter("order", "which way round", {"type": "string", "enum": ["asc", "desc"], "default": "asc"}),
    Parameter("q", "text in method or team", {"type": "string", "maxLength": LONGEST_TEXT}),
    Parameter("tier", "source of the numbers; all if none is given", _choice(TIERS)),
    Parameter("state", "which records; the current ones if none is given", _choice(STATES)),
    Parameter("page", "from 1", {"type": "integer", "minimum": 1, "default": 1}),
    Parameter(
        "size",
        f"rows of a page, rounded up to one of {', '.join(map(str, SIZES))}",
        {"type": "integer", "minimum": 1, "maximum": MOST_ROWS},
    ),
)
PAIR_QUERY = (
    Parameter("a", "digest of a record (8 digits or more), or a method", {"type": "string"}),
    Parameter("b", "digest of a record (8 digits or more), or a method", {"type": "string"}),
    Parameter(
        "r",
        "any number of these, instead of a and b",
        {"type": "array", "items": {"type": "string"}, "maxItems": MOST},
    ),
)

BOARD = {"board": BoardInfo, "query": Query, "total": int, "pages": int, "rows": list[Row]}


def _chosen(asked: Asked) -> tuple[str, ...]:
    """What is to be compared, given as `a` and `b` or as several `r`; at least two names, which may be empty."""
    a, b = ((asked.get(key) or [""])[-1] for key in ("a", "b"))
    ticked = [name for name in asked.get("r", ()) if name.strip()]
    names = [a, b] if a or b else [*ticked, "", ""][: max(2, len(ticked))]
    return tuple(name.strip()[:100] for name in names)


def _compared(site: Site, names: Sequence[str]) -> Page:
    """Page that compares two records head to head, or more side by side."""
    return compare_page(site, *names) if len(names) == 2 else several_page(site, names)


ROUTES = (
    Route(
        "/",
        "All boards, with their leaders.",
        lambda site, given, asked: home_page(site),
        {"boards": Objects},
    ),
    Route(
        "/boards/{track}/{split}",
        "The newest board of a split.",
        lambda site, given, asked: board_page(site, given["track"], given["split"], None, asked),
        BOARD,
        parse_query,
        BOARD_QUERY,
    ),
    Route(
        "/boards/{track}/{split}/{board}",
        "A board by its permanent ID.",
        lambda site, given, asked: board_page(site, given["track"], given["split"], given["board"], asked),
        BOARD,
        parse_query,
        BOARD_QUERY,
    ),
    Route(
        "/methods/{method}",
        "All records of a method, by its name as spelled in page addresses.",
        lambda site, given, asked: method_page(site, given["method"]),
        {"method": str, "teams": list[str], "records": list[Row]},
    ),
    Route(
        "/records/{digest}",
        "A record.",
        lambda site, given, asked: record_page(site, given["digest"]),
        {
            "row": Row,
            "board": BoardInfo,
            "withdrawn": list[str] | None,
            "superseded_by": str | None,
            "per_sequence": Objects,
            "status_changes": list[StatusChange],
        },
    ),
    Route(
        "/compare",
        "Records, or the current records of methods: two head to head, more side by side.",
        lambda site, given, asked: _compared(site, asked),
        {
            "a": Row | None,
            "b": Row | None,
            "difference": Comparison | None,
            "pairs": Objects | None,
            "records": list[Row],
            "means": dict[str, Any],
            "per_sequence": Objects,
        },
        _chosen,
        PAIR_QUERY,
        records_compared,
    ),
    Route("/data", "All data sets.", lambda site, given, asked: data_page(site), {"data_sets": Objects}),
    Route(
        "/data/{split}",
        "A data set: its recipe, the conditions of its sequences, its boards.",
        lambda site, given, asked: split_page(site, given["split"]),
        {
            "name": str,
            "version": str,
            "track": str,
            "hidden": bool,
            "sequences": list[str],
            "conditions": dict[str, Any],
            "boards": Objects,
        },
    ),
    Route(
        "/literature",
        "Results reported by others on other data; never ranked with ours.",
        lambda site, given, asked: literature_page(site),
        {"literature": list[Literature]},
    ),
    Route(
        "/submit",
        "How to submit.",
        lambda site, given, asked: submit_page(site),
        {"form": str | None, "splits": Objects},
    ),
    Route(
        "/log",
        "Records withdrawn, restored, superseded or rescored.",
        lambda site, given, asked: log_page(site),
        {"events": Objects, "left_out": dict[str, str]},
    ),
    Route(
        "/about",
        "What rank, tie, tier, coverage and each metric mean.",
        lambda site, given, asked: about_page(site),
        {"tiers": dict[str, str], "metrics": Objects},
    ),
)

FILES = {
    "/records/{digest}/record.json": "The record itself, as it was published: its SHA-256 is the digest.",
    "/records/{digest}/curves.json": "The paths and errors drawn on its page.",
    "/openapi.json": "This description.",
    "/health": "Whether the site is up.",
}
"""Other addresses -> what they return."""
