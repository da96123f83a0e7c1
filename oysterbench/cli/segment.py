"""The command that counts oysters in users' own images and videos: parse, call, print."""

from __future__ import annotations

import json
import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.echo import echo, message
from oysterbench.cli.interrupts import started_over
from oysterbench.cli.numbers import Number
from oysterbench.core.errors import LabelError, MethodError

if TYPE_CHECKING:
    from oysterbench.counting.run import ScaleOf
    from oysterbench.counting.sources import Found, Source
    from oysterbench.counting.survey import Survey
    from oysterbench.counting.tables import PictureTable

METHOD = "unet_instances"
TRACKS = ("detection", "segmentation")
FILE = click.Path(path_type=Path, dir_okay=False)
TOLD = 5
"""Maximum number of failures printed on stderr."""


@click.command("segment", short_help="Find oysters in your own images and videos: masks, counts, cover, a page.")
@click.argument("paths", metavar="PATH...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--method", default=METHOD, show_default=True, help="A method of the track detection or segmentation.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder.  [default: NAME-oysters]")
@click.option("--threshold", type=Number(0, 1), default=0.5, show_default=True, help="Minimum score.")
@click.option("--rate", type=Number(min=0, min_open=True), help="Frames per second taken from videos.  [default: 1]")
@click.option("--every", type=click.IntRange(min=1), metavar="N", help="Take every N-th frame of videos instead.")
@click.option(
    "--quadrat",
    type=Number(min=0, min_open=True),
    metavar="M",
    help="Side length of a square quadrat; needs --corners.",
)
@click.option("--corners", type=FILE, help="CSV: image,x1,y1,...,x4,y4 in px, for each quadrat.")
@click.option(
    "--altitude",
    metavar="M|FILE",
    help="Altitude above a flat bottom, or CSV: image,altitude_m; needs --calibration.",
)
@click.option(
    "--calibration", type=click.Path(path_type=Path), help="Made in water: Kalibr, EuRoC or ROS YAML, or a sequence."
)
@click.option("--camera", metavar="NAME", help="Which camera of the calibration.  [default: the first]")
@click.option("--mm-per-px", type=float, help="A plain scale, for images taken straight down.")
@click.option(
    "--min-mm",
    type=Number(min=0),
    metavar="MM",
    help="Minimum length; needs a scale.  [default: 25 for connected parts of a mask, else 0]",
)
@click.option(
    "--min-px",
    type=Number(min=0),
    metavar="N",
    help="Minimum area.  [default without a scale: 49 at 640 px for connected parts of a mask, else 0]",
)
@click.option(
    "--block", type=click.IntRange(min=1), metavar="N", help="Resample this many neighbouring images together."
)
@click.option(
    "--checked", type=click.Path(path_type=Path), help="Results of `run --on` your labels, to show on the page."
)
@click.option("--coco", is_flag=True, help="Also write instances.json, for correction by hand.")
@click.option("--again", is_flag=True, help="Recount what is finished; without it, an interrupted recount resumes.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON.")
def segment_command(
    paths: tuple[Path, ...],
    method: str,
    out: Path | None,
    threshold: float,
    rate: float | None,
    every: int | None,
    min_mm: float | None,
    min_px: float | None,
    block: int | None,
    checked: Path | None,
    coco: bool,
    again: bool,
    as_json: bool,
    **scaling: Any,
) -> None:
    """Find, outline, count and measure oysters in your own images and videos.

    PATH is an image, a folder (with its subfolders) or a video; several may be given.

    \b
    Examples:
      oysterbench segment dive/ --out counted
      oysterbench segment GX010023.MP4 --rate 0.5
      oysterbench segment photos/ --quadrat 0.5 --corners corners.csv       oysters per square metre
      oysterbench segment survey/ --altitude 1.2 --calibration camchain.yaml
      oysterbench segment photos/ --mm-per-px 0.8 --method "unet_instances[checkpoint=mine.pt]"
      oysterbench segment photos/ --method my_net:MyNet --threshold 0.6 --coco

    \b
    The folder gets
      index.html      one page: counts and cover with intervals, outlines, warnings, how to check it
      images.csv      oysters, cover, live and dead, novelty of each image      summary.json  totals
      oysters.csv     box, area, score, state, length and width of each oyster
      masks/          16-bit PNG, a number for each oyster that counts   overlays/, videos/  outlines

    Images are JPEG, PNG, TIFF, BMP or WebP, rotated by their EXIF orientation. Of a method that gives only masks, the
    connected parts are counted, so that touching oysters are one; specks below --min-mm or --min-px are not. Corners
    are in px of the upright image as a player shows it, with square pixels, in any order; for a video, give one line
    for all frames, or VIDEO/NUMBER for one frame. Within a quadrat, an oyster counts if its centre is inside. Without
    one, an oyster cut by the image edge counts as half in oysters per square metre.

    Intervals resample images and, for a video, blocks of 10 s, since neighbouring frames show the same ground; --block
    N resamples N neighbours together. The intervals cover sampling only, not the method's overcounting or
    undercounting. For stereo pairs, or to count oysters in overlapping images once: `oysterbench map`.

    Finished work is kept: it is repeated only with --again, or if image, settings, or the method's code or declared
    weights have changed.
    Exits with 1 if an image or video could not be counted; the rest is counted.
    """
    from oysterbench.counting.sources import find_sources

    if rate is not None and every is not None:
        raise click.UsageError("--rate, --every: expected only one of them")
    _check_scaling(scaling, min_mm)
    title = paths[0].absolute().name if len(paths) == 1 else f"{paths[0].name} and {len(paths) - 1} more"
    out = out or Path(f"{paths[0].absolute().stem or 'images'}-oysters")
    found = find_sources(paths, leave_out=out)
    _tell_others(found)

    from oysterbench.methods.finding import find_variant

    chosen: Any  # of which track, is checked next
    chosen, options = find_variant(method)
    if chosen.track not in TRACKS:
        raise MethodError(f"{method}: expected a method of {' or '.join(TRACKS)}, got one of {chosen.track}")

    # These imports are slow, so everything that can be refused without them has been.
    from oysterbench.cli.render import frames_bar
    from oysterbench.counting.accuracy import figures_of_counts, read_accuracy, saw_rendered_reefs_alone
    from oysterbench.counting.coco import is_as_counted
    from oysterbench.counting.identity import method_identity
    from oysterbench.counting.least import Least
    from oysterbench.counting.reading import Sampling
    from oysterbench.counting.run import Counting, Settings
    from oysterbench.counting.store import Store
    from oysterbench.counting.survey import survey
    from oysterbench.methods.weights import have_weights, weights_digests, weights_of
    from oysterbench.report.counting import COCO, Making, check_folder, write_counts

    scale, about_scale, table = _scale(scaling, found.sources)
    weights = weights_of(chosen)
    have_weights(weights, message, frames_bar)
    accuracy = None if checked is None else read_accuracy(checked, chosen.name, weights_digests(weights))
    least = Least(min_mm, min_px)
    settings = Settings(threshold, Sampling(rate or 1.0, every), scale, least)
    identity = method_identity(method, chosen, options)
    store = Store(out)
    check_folder(store, coco)
    if again:
        by_kind = [[one.name for one in found.sources if one.video is video] for video in (False, True)]
        store.start_over(*by_kind)
        started_over()
    with frames_bar("counting oysters", "images") as progress:
        counted = Counting(found.sources, chosen, identity, store, settings, progress).run()
    counted.failures.update(found.unreadable())
    figures = figures_of_counts(weights, chosen.name)
    kind = "" if about_scale is None else about_scale["kind"]
    whole_m2 = math.nan if scaling["quadrat"] is None else scaling["quadrat"] ** 2
    result = survey(
        title,
        chosen.name,
        counted.pictures,
        counted.failures,
        block,
        accuracy,
        figures,
        kind,
        least,
        counted.copies,
        whole_m2,
        saw_rendered_reefs_alone(weights),
    )
    videos = any(source.video for source in found.sources)
    said = {
        "threshold": threshold,
        "frames_per_s": (rate or 1.0) if videos and every is None else None,
        "every": every,
        "scale": about_scale,
        "min_mm": min_mm,
        "min_px": min_px,
        "block": block,
    }
    command = shlex.join(["oysterbench", *sys.argv[1:]])
    names = {*(one.name for one in counted.pictures), *counted.failures}
    if table is not None:
        unused = table.besides({*names, *(source.name for source in found.sources)})
        _tell_unused(table.path, unused, "frame that was counted")
    earlier = store.others(names)
    if earlier:
        noun = "image or frame" if len(earlier) == 1 else "images and frames"
        more = f" and {len(earlier) - 3} more" if len(earlier) > 3 else ""
        message(
            f"{out}: masks and overlays of {len(earlier)} {noun} of earlier counts are still there, and not in the "
            f"tables: {', '.join(earlier[:3])}{more}"
        )
    if not coco and (out / COCO).exists():
        anew = ": --coco writes it anew" if is_as_counted(out / COCO) else ""
        message(f"{out / COCO} is of an earlier count, and may not agree with the tables{anew}")
    written = write_counts(result, counted, store, Making(command, identity, said), coco)
    if as_json:
        echo(json.dumps({**result.as_plain(), "files": [str(path) for path in written]}, indent=2))
    else:
        _tell(result, written[0], counted.made, counted.cpu_s)
    _warn(result)
    if result.failures:
        raise LabelError(_failed(result))


def _check_scaling(given: dict[str, Any], min_mm: float | None) -> None:
    """Refuse scale options that do not go together. Raises click.UsageError."""
    names = {"quadrat": "--quadrat", "altitude": "--altitude", "mm_per_px": "--mm-per-px"}
    kinds = [option for key, option in names.items() if given[key] is not None]
    if len(kinds) > 1:
        raise click.UsageError(f"{', '.join(kinds)}: expected at most one scale")
    if min_mm is not None and not kinds:
        raise click.UsageError(f"--min-mm: expected a scale as well ({', '.join(names.values())}); else give --min-px")
    for key, needed, what in (
        ("quadrat", "corners", "--quadrat: expected --corners FILE as well, with image,x1,y1,x2,y2,x3,y3,x4,y4"),
        ("corners", "quadrat", "--corners: expected --quadrat M as well, the side of the square in metres"),
        ("altitude", "calibration", "--altitude: expected --calibration FILE as well: a lens tells px from metres"),
        ("calibration", "altitude", "--calibration: expected --altitude M as well, in metres above the bottom"),
        ("camera", "calibration", "--camera: expected --calibration FILE as well"),
    ):
        if given[key] is not None and given[needed] is None:
            raise click.UsageError(what)


def _scale(
    given: dict[str, Any], sources: tuple[Source, ...]
) -> tuple[ScaleOf, dict[str, Any] | None, PictureTable | None]:
    """Scale of each image, its description for records, None without a scale, and the table it is from, if any."""
    from oysterbench.counting.lens import read_lens
    from oysterbench.counting.per_picture import ALTITUDE, CORNERS, altitudes, plain, quadrats
    from oysterbench.counting.tables import read_table

    if given["mm_per_px"] is not None:
        return plain(given["mm_per_px"]), {"kind": "plain", "mm_per_px": given["mm_per_px"]}, None
    if given["quadrat"] is not None:
        table = read_table(given["corners"], CORNERS, sources)
        _tell_unused(table.path, table.unused)
        return quadrats(given["quadrat"], table), {"kind": "quadrat", "size_m": given["quadrat"]}, table
    if given["altitude"] is not None:
        metres = _metres(given["altitude"])
        lens = read_lens(given["calibration"], given["camera"])
        about = {"kind": "altitude", "altitude": given["altitude"], "calibration": given["calibration"].name}
        if metres is not None:
            return altitudes(lens, metres), about, None
        altitude = read_table(Path(given["altitude"]), ALTITUDE, sources)
        _tell_unused(altitude.path, altitude.unused)
        return altitudes(lens, altitude), about, altitude
    return (lambda source, name: None), None, None


def _metres(altitude: str) -> float | None:
    """Altitude, or None if it is the name of a file. Raises click.UsageError if it is neither."""
    try:
        return float(altitude)
    except ValueError:
        if Path(altitude).exists():
            return None
        raise click.UsageError(f"--altitude: expected metres, such as 0.4, or a CSV file, got {altitude}") from None


def _tell_others(found: Found) -> None:
    from oysterbench.counting.labels import seeming_labels
    from oysterbench.counting.sources import listed

    if found.copies:
        message(f"left out because an image of the same name is beside them: {listed(found.copies)}")
    if found.repeated:
        message(f"left out because they are links to, or other paths of, what is counted: {listed(found.repeated)}")
    if found.others:
        message(f"left out because they are neither image nor video: {listed(found.others)}")
    if found.skipped:
        message(
            "left out because they are or hold labels, hold results of another count, or are hidden: "
            f"{listed(found.skipped)}"
        )
    for labels, images in seeming_labels(source.path for source in found.sources if not source.video).items():
        message(
            f"{labels} is counted, though its images seem to be labels of those in {images}, by their names and few "
            "colours: if they are, move the folder elsewhere, or give that of the images alone"
        )


def _tell_unused(path: Path, names: tuple[str, ...], what: str = "image") -> None:
    if names:
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        message(f"{path}: no {what} is called {', '.join(names[:3])}{more}; these lines are not used")


def _tell(found: Survey, page: Path, made: int, cpu_s: float) -> None:
    """Print the path of the page, and a line for each number; nothing if no image was counted: the failures say why."""
    from oysterbench.counting.survey import PARTS
    from oysterbench.report.table import Column

    if not found.pictures:
        return

    echo(page)
    each = f" ({made} counted now, {cpu_s / made:.2f} CPU-s each)" if made else ""
    each = " (all finished before)" if found.pictures and not made else each
    noun = "image" if len(found.pictures) == 1 else "images"
    what = f"{PARTS}," if found.parts else "oyster" if found.oysters == 1 else "oysters"
    echo(f"{found.oysters} {what} in {len(found.pictures)} {noun}{each}")
    if found.small:
        echo(f"Not counted, smaller than {found.at_least}: {found.small}")
    unknown = [one for one in found.measures if not one.ratio.interval.known]
    for reason in dict.fromkeys(one.ratio.interval.reason for one in unknown):
        own = [one.heading for one in unknown if one.ratio.interval.reason == reason]
        echo(reason if len(own) == len(found.measures) else f"{', '.join(own)}: {reason}")
    for one in found.measures:
        column = Column("", kind="interval", digits=one.digits)
        interval = one.ratio.interval
        span = f" [{column.text(interval)}]" if interval.known else ""
        echo(f"{one.heading}: {Column('', digits=one.digits).text(one.ratio.value)}{span} {one.unit}".rstrip())


def _warn(found: Survey) -> None:
    """Print warnings that qualify the numbers."""
    for doubt in found.doubts:
        message(doubt)
    unlike = found.unlike
    if unlike:
        names = ", ".join(one.name for one in unlike[:3])
        more = f" and {len(unlike) - 3} more" if len(unlike) > 3 else ""
        message(
            f"unlike the training data of {found.method}, so their counts are not reliable: {len(unlike)} of "
            f"{len(found.pictures)} images: {names}{more}"
        )
    if not math.isnan(found.alike):
        what = "images" if found.block == "images" else "blocks"
        message(
            f"neighbouring {what} have similar counts (correlation {found.alike:.2f}), so intervals may be too narrow: "
            "--block N resamples N neighbours together"
        )


def _failed(found: Survey) -> str:
    """Print the first failures. Returns the last line of a run that could not count everything."""
    failures = found.failures
    for name, why in list(failures.items())[:TOLD]:
        message(why if name in why else f"{name}: {why}")
    more = f", {len(failures) - TOLD} more are in images.csv" if len(failures) > TOLD else ""
    rest = "; the rest was counted" if found.pictures else ""
    begun = (
        ", or not to the end"
        if any(one.video and one.name.rpartition("/")[0] in failures for one in found.pictures)
        else ""
    )
    return f"{len(failures)} of {len(failures) + len(found.pictures)} could not be counted{begun}{more}{rest}"
