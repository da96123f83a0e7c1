"""`oysterbench leaderboard serve`, `build` and `frames`: parse, call, print."""

from __future__ import annotations

from pathlib import Path

import click

from oysterbench.cli.echo import message
from oysterbench.cli.publish import PROXY
from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.commands.options import Place, find_place

FOLDER = click.Path(path_type=Path, file_okay=False)

BOARD = click.option(
    "--board",
    "folder",
    type=FOLDER,
    help="Folder of the records.  [default: OYSTERBENCH_BOARD, or the shipped records]",
)
INDEX = click.option(
    "--index", "url", help="Index: a file (SQLite) or postgresql://...  [default: a file under the home folder]"
)


def _place(context: click.Context, folder: Path | None, url: str | None) -> Place:
    """Folder and index as given to this command, or else to its group."""
    given = find_place(context)
    return Place(folder or given.folder, url or given.url)


@click.command("serve", short_help="Serve the site, and accept submissions.")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on; 0.0.0.0 for all.")
@click.option("--port", default=8000, show_default=True, type=click.IntRange(0, 65535))
@BOARD
@INDEX
@click.option("--submissions", type=FOLDER, help="Accept submissions; private folder of tokens, queue and estimates.")
@click.option(
    "--truth",
    "truths",
    multiple=True,
    metavar="SPLIT=DIR",
    help="Ground truth of a split, or of a recipe of your own: FILE.toml=DIR; repeatable.",
)
@click.option(
    "--workers", type=click.IntRange(min=1), help="Submissions scored at once.  [default: as set in the folder]"
)
@click.option("--scheduler", default="", metavar="ADDRESS", help="Score on the workers of a Dask scheduler instead.")
@click.option("--metrics", default="", metavar="HOST:PORT", help="Address for Prometheus metrics; needs --submissions.")
@click.option("--root", default="", help="Path prefix that a proxy adds to the site's addresses, such as /board.")
@PROXY
@click.pass_context
def serve_command(
    context: click.Context,
    host: str,
    port: int,
    folder: Path | None,
    url: str | None,
    submissions: Path | None,
    truths: tuple[str, ...],
    workers: int | None,
    scheduler: str,
    metrics: str,
    root: str,
    proxies: tuple[str, ...],
) -> None:
    """Serve the site: boards, records, data sets. With --submissions, accept estimates and score them.

    \b
    Examples:
      oysterbench leaderboard serve
      oysterbench leaderboard serve --board board --index postgresql://board@db/board --host 0.0.0.0
      oysterbench leaderboard serve --board board --submissions private \\
        --truth slam-test=truth/slam-test --truth my-split.toml=truth/my-split
      oysterbench leaderboard serve --submissions private --truth ... --scheduler tcp://10.0.0.1:8786

    New records in the folder are shown within seconds. For public access, put a TLS proxy in front of the server and
    name it with --proxy. `oysterbench leaderboard team` creates teams and their tokens.
    """
    from oysterbench.hub.connections import address, listen, run
    from oysterbench_leaderboard.site.running import whole

    if truths and submissions is None:
        raise click.UsageError("--truth is the ground truth for submissions: give --submissions as well")
    if metrics and submissions is None:
        raise click.UsageError("--metrics are about submissions: give --submissions as well")
    if scheduler and workers is not None:
        raise click.UsageError("--workers and --scheduler cannot be combined: a cluster has its own workers")
    if root and (not root.startswith("/") or root.endswith("/")):
        raise click.UsageError(f"--root: expected a path like /board, got {root!r}")
    listening = listen(host, port)
    app = whole(_place(context, folder, url).index(), submissions, truths, workers, root, scheduler, metrics)
    if submissions is not None:
        from oysterbench_leaderboard.submissions.sandbox.sandbox import in_force

        message(f"uploads are read and scored in a sandbox: {in_force()}")
    message(f"serving {address(host, listening, root)} (stop with Ctrl-C)")
    run(app, listening, "on", proxies)


@click.command("build", short_help="Write the whole site as files, for any web host.")
@click.argument("target", metavar="DIR", type=FOLDER)
@BOARD
@INDEX
@click.pass_context
def build_command(context: click.Context, target: Path, folder: Path | None, url: str | None) -> None:
    """Write the whole site as files: pages, their JSON, CSV and LaTeX, records, curves, OpenAPI.

    \b
    Examples:
      oysterbench leaderboard build site
      rsync -a --delete site/ host:/var/www/board/

    The site works from any web host, in any folder, and from disk. DIR is replaced as a whole once everything is
    written; unchanged files keep their timestamps.
    """
    import sys

    from oysterbench.core.permissions import closed_to_others
    from oysterbench_leaderboard.site.export import export
    from oysterbench_leaderboard.site.running import site_of

    def progress(done: int, of: int) -> None:
        if sys.stderr.isatty() and (done % 20 == 0 or done == of):
            click.echo(f"\r{done} of {of} pages", err=True, nl=done == of)  # noqa: TID251

    def report(file: str, why: str) -> None:
        message(f"left out: {file[:12]}: {why}")

    index = _place(context, folder, url).index()
    for file, why in index.problems().items():
        report(file, why)
    try:
        count = export(site_of(index), target, progress, report)
    except OSError as error:
        raise ResultError(f"{target}: cannot be written: {error.strerror or error}") from None
    message(f"{target}: {count} files; open {target / 'index.html'}")
    if closed := closed_to_others(target, target / "index.html"):
        message(closed)


@click.command("frames", short_help="Render the preview image of each data set.")
@click.argument("splits", metavar="[SPLIT]...", nargs=-1)
@click.option("--out", type=FOLDER, help="Folder of the images.  [default: that of this version]")
def frames_command(splits: tuple[str, ...], out: Path | None) -> None:
    """Render the preview image of each data set on the board's pages, as small WebP.

    \b
    Examples:
      oysterbench leaderboard frames
      oysterbench leaderboard frames seg-val seg-closeup

    datasets/frames/frames.toml says which frame it is. The image of a hidden split only shows its appearance: it is
    rendered without the secret.
    """
    from oysterbench.cli.render import frames_bar
    from oysterbench.core.atomic import write_atomically
    from oysterbench_leaderboard.site.frames import SUFFIX, choices, folder, render_picture

    known = choices()
    if unknown := [split for split in splits if split not in known]:
        raise click.UsageError(f"no frame is defined for {unknown[0]}: expected some of {', '.join(known)}")
    target = out or Path(str(folder()))
    wanted = splits or tuple(known)
    with frames_bar("rendering frames") as progress:
        for k, split in enumerate(wanted):
            progress(k, len(wanted))
            write_atomically(target / f"{split}{SUFFIX}", render_picture(known[split]))
        progress(len(wanted), len(wanted))
    message(f"{target}: {len(wanted)} images")
