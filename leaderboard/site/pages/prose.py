"""Pages on how to submit, and on what the numbers mean."""

from __future__ import annotations

from dataclasses import asdict

from oysterbench.evaluate.metrics import TRACKS, find_metric
from oysterbench.evaluate.statistics import LEAST_SEQUENCES, RESAMPLES
from oysterbench.report.columns import OF_TRACK, STANDING_OF_TRACK, metric_column
from oysterbench.report.renderers import json_rows
from oysterbench.report.table import ABSENT, Cell, Column, Table, TableRow
from oysterbench.results.records import plain
from oysterbench.results.standings import PRIMARY
from oysterbench_leaderboard.site import datasets, numbers
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.pages.ranks import ABOUT_TIERS
from oysterbench_leaderboard.site.paths import data_path
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.submissions.catalogue import ELSEWHERE, TRACKS_OF

FORMS = {
    "slam": "a TUM file for each sequence, named like it (val-01.tum): t x y z qx qy qz qw, the body's pose in the map",
    "segmentation": "masks as PNG, or COCO JSON, for each clip",
    "detection": "COCO JSON with the mask of each oyster, for each clip",
    "steering": "a CSV file for each sequence, named like it (val-01.csv): stamp_ns,yaw,pitch with the classes per "
    "image, or stamp_ns,yaw_0,...,pitch_0,... with their probabilities",
}
"""Track of a board -> what to send."""


RESULTS = "a results.json of oysterbench run, marked as reported: the truth is not on this server"
"""What to send where estimates cannot be scored."""

SHOWN = "slam-val"
"""Split in the commands of a site that scores no paths on a public split."""

COMPARED = ("-val", "-test")
"""Ends of the names of splits on which methods are compared, listed where no submissions are accepted."""


def submit_page(site: Site) -> Page:
    """Page on what can be submitted, and how."""
    columns = (
        Column("track", "Track"),
        Column("split", "Data set"),
        Column("truth", "Truth"),
        Column("send", "What is sent"),
    )
    known = datasets.known()
    splits = site.accepted or [
        {"split": name, "tracks": TRACKS_OF[of.track], "hidden": of.hidden, "takes": ["estimates"]}
        for name, of in known.items()
        if of.track in TRACKS_OF and name.endswith(COMPARED)
    ]
    splits = sorted(splits, key=lambda split: ("estimates" not in split["takes"], not split["hidden"], split["split"]))
    public = (split for split in splits if not split["hidden"] and "slam" in split["tracks"])
    scored = (split["split"] for split in public if "estimates" in split["takes"])
    lines = [
        TableRow(
            (
                Cell(track, numbers.track_name(track)),
                Cell(split["split"], path=data_path(split["split"]) if split["split"] in known else ""),
                Cell("hidden" if split["hidden"] else "public"),
                Cell(FORMS[track] if "estimates" in split["takes"] else RESULTS, kind="wrap"),
            )
        )
        for split in splits
        for track in split["tracks"]
    ]
    notes = tuple(
        f"{numbers.track_name(track)} cannot be sent: {reason.replace('`', '')}." for track, reason in ELSEWHERE.items()
    )
    table = Table("What can be sent", columns, tuple(lines), notes, "submit")
    data = plain({"form": site.form or None, "splits": json_rows(table), "elsewhere": ELSEWHERE})
    context = {"form": site.form, "tiers": ABOUT_TIERS, "split": next(scored, SHOWN)}
    return Page("/submit", "How to submit", "submit.html", context, (table,), data)


def about_page(site: Site) -> Page:
    """Page on what rank, tie, tier, coverage and each metric mean."""
    columns = (
        Column("track", "Track"),
        Column("name", "Name"),
        Column("unit", "Unit"),
        Column("better", "Better"),
        Column("definition", "Definition"),
        Column("key", "Key"),
    )
    lines, data = [], []
    for track in PRIMARY:
        keys = dict.fromkeys((PRIMARY[track], *(c.key for c in (*STANDING_OF_TRACK[track], *OF_TRACK[track]))))
        for key in keys:
            metric = find_metric(key)
            if metric is None:
                continue
            heading = metric_column(key)
            lines.append(
                TableRow(
                    (
                        Cell(track, numbers.track_name(track)),
                        Cell(heading.heading, mark="ranks" if key == PRIMARY[track] else ""),
                        Cell(heading.unit, heading.unit or ABSENT),
                        Cell(metric.better, metric.better or "describes"),
                        Cell(heading.about, kind="wrap"),
                        Cell(key),
                    )
                )
            )
            data.append({"track": track, "key": key, "ranks": key == PRIMARY[track], **asdict(metric)})
    table = Table("Metrics", columns, tuple(lines), name="metrics")
    context = {
        "tiers": ABOUT_TIERS,
        "level": numbers.LEVEL,
        "resamples": f"{RESAMPLES:,}".replace(",", "\N{NARROW NO-BREAK SPACE}"),
        "least": LEAST_SEQUENCES,
        "ranking": [(numbers.track_name(track), metric_column(key, track=track)) for track, key in PRIMARY.items()],
        "coverage": metric_column("coverage"),
        "losing": [
            (numbers.track_name(name), of.lost_below) for name, of in TRACKS.items() if of.lost_below is not None
        ],
    }
    return Page(
        "/about",
        "What the numbers mean",
        "about.html",
        context,
        (table,),
        plain({"tiers": ABOUT_TIERS, "metrics": data}),
    )
