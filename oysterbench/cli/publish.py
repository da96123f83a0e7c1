"""Commands for those who run a hub: `keygen`, `publish` and `serve`: parse, call, print. `cli.main` adds them."""

from __future__ import annotations

import json
from pathlib import Path

import click

from oysterbench.cli.echo import echo, message
from oysterbench.core.errors import HubError
from oysterbench.core.names import counted

FOLDER = click.Path(path_type=Path, file_okay=False)
FILE = click.Path(path_type=Path, dir_okay=False)


@click.command(short_help="Make the key that signs a hub's index.")
@click.argument("path", type=FILE, metavar="FILE")
def keygen(path: Path) -> None:
    """Make a private key for a hub, and print the public key, which its users pass with --key.

    \b
    Examples:
      oysterbench keygen my-hub.pem

    Keep the file private and keep a copy: without it, clients accept no new index.
    """
    from oysterbench.hub.sign import make_key

    public = make_key(path)
    message(f"private key: {path}; public key, for users to set as OYSTERBENCH_HUB_KEY or --key:")
    echo(public)


PROXY = click.option(
    "--proxy",
    "proxies",
    multiple=True,
    metavar="ADDRESS",
    help="A proxy in front of the server, trusted to name the client's address; repeatable.",
)


@click.command(short_help="Publish a split as a tree that any web server can serve.")
@click.argument("split_name", metavar="SPLIT")
@click.argument("tree", type=FOLDER, metavar="DIR")
@click.option("--key", "key_file", type=FILE, required=True, help="Private key, from `oysterbench keygen`.")
@click.option("--old-key", "old_files", type=FILE, multiple=True, help="Previous key, which also signs; repeatable.")
@click.option("--data", type=FOLDER, help="Folder of the rendered files.  [default: under the home folder]")
@click.option("--salt-file", type=FILE, help="Secret of a hidden split, to find its files under the home folder.")
@click.option("--url", default="", help="Address that the tree will have, for the Croissant metadata.")
@click.option("--hidden", is_flag=True, help="Leave out recipe and ground truth; publish a commitment to it.")
@click.option("--truth-out", type=FOLDER, help="Folder for the ground-truth package, with --hidden.")
@click.option("--json", "as_json", is_flag=True, help="Print what was published as JSON.")
def publish(
    split_name: str,
    tree: Path,
    key_file: Path,
    old_files: tuple[Path, ...],
    data: Path | None,
    salt_file: Path | None,
    url: str,
    hidden: bool,
    truth_out: Path | None,
    as_json: bool,
) -> None:
    """Publish a rendered split into a static tree: a signed index, manifests, content-addressed blobs, a page.

    \b
    Examples:
      oysterbench publish slam-val hub --key my-hub.pem
      oysterbench publish slam-test hub --key my-hub.pem \\
        --hidden --truth-out truth --salt-file slam-test.salt

    Publishing twice adds nothing; an interrupted publish leaves the tree as it was. A released version never changes.
    """
    if hidden != (truth_out is not None):
        raise click.UsageError("--hidden and --truth-out belong together: expected both or none")

    from oysterbench.core.permissions import closed_to_others
    from oysterbench.hub.publish import check_made_by, publish
    from oysterbench.hub.relisted import is_listed
    from oysterbench.hub.sign import load_key, public_hex
    from oysterbench.recipe import load_split
    from oysterbench.simulation.generate import digest, sequence_files, split_folder
    from oysterbench.simulation.jobs import wanted_topics
    from oysterbench.simulation.salt import salt_for

    split = load_split(split_name)
    if split.hidden and not hidden:
        raise HubError(
            f"{split.name} is a hidden split: publishing it like this would reveal its ground truth; nothing was "
            "published: give --hidden and --truth-out"
        )
    key, old_keys = load_key(key_file), [load_key(file) for file in old_files]
    folder = data or split_folder(split, salt_for(split.name, split.hidden, salt_file))
    files = sequence_files(split, folder)
    topics = {one.name: wanted_topics(split, one) for one in split.sequence}
    shared = {"version": split.version, "track": split.track, "summary": split.summary}
    facts = {"split": split.name, "rig": split.rig.name, **shared}
    if hidden or not is_listed(tree, (key, *old_keys), facts, files):  # those of a release are as they were then
        check_made_by(files, split.name, split.version, digest(split), hidden, topics, split.texts)
    manifest = publish(tree, facts, files, key, digest(split), url, message, old_keys, truth_out)
    if as_json:
        echo(json.dumps({**manifest.facts, "key": public_hex(key), "folder": str(tree)}, indent=2))
        return
    count = counted(len(manifest.files), "file")
    message(f"{manifest.split} {manifest.version}: {count}, {manifest.size / 1e6:.1f} MB in {tree}")
    if manifest.commitment:
        message(f"commitment: {manifest.commitment}")
    message(f"public key: {public_hex(key)}")
    if closed := closed_to_others(tree, tree / "index.json"):
        message(closed)
    echo(manifest.sha256)


@click.command(short_help="Serve a published tree.")
@click.argument("tree", type=FOLDER, metavar="DIR")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on; 0.0.0.0 for all.")
@click.option("--port", type=click.IntRange(0, 65535), default=8000, show_default=True, help="0 for any free port.")
@PROXY
def serve(tree: Path, host: str, port: int, proxies: tuple[str, ...]) -> None:
    """Serve a published tree: range and conditional requests, a page with images and sizes, /health.

    \b
    Examples:
      oysterbench serve hub
      oysterbench serve hub --host 0.0.0.0 --port 8080

    Any static web server, object store or shared folder works too.
    """
    from oysterbench.hub.serve import serve

    serve(tree, host, port, proxies, lambda url: message(f"serving {url} (stop with Ctrl-C)"))


COMMANDS = (keygen, publish, serve)
