"""Commands for trained weights: listing and publishing them, and fetching them for `download`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.echo import echo, message
from oysterbench.core.errors import HubError, MethodError

if TYPE_CHECKING:
    from collections.abc import Callable

    from oysterbench.hub.download import Hub
    from oysterbench.hub.model import Model
    from oysterbench.hub.weights import Here

FOLDER = click.Path(path_type=Path, file_okay=False)
FILE = click.Path(path_type=Path, dir_okay=False)


def card_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of which the card of a release is made (`release_card`)."""
    results = click.Path(path_type=Path)
    for option in (
        click.option("--licence", metavar="URL", help="Licence of the weights.  [default: CC BY 4.0]"),
        click.option("--limits", help="What the weights are not for.  [default: what is known of MODEL]"),
        click.option("--summary", help="One line about the weights.  [default: what is known of MODEL]"),
        click.option(
            "--results",
            type=results,
            multiple=True,
            metavar="PATH",
            help="Results with these weights: results.json of `run` or `eval`, or its folder; repeatable.",
        ),
        click.option("--version", help="Version of the release, which never changes.  [default: 1.0]"),
        click.option("--weights", "path", type=FILE, help="The weights file.  [default: the one that MODEL runs on]"),
    ):
        command = option(command)
    return command


def release_card(
    name: str,
    path: Path | None,
    version: str | None,
    results: tuple[Path, ...],
    summary: str | None,
    limits: str | None,
    licence: str | None,
) -> tuple[Path, Model]:
    """The weights file to release, and its card. Weights that were released before keep the card that they have, unless
    an option asks for another."""
    from oysterbench.hub.manifest import VERSION_NAME
    from oysterbench.hub.publish_model import build_model, describe_weights
    from oysterbench.methods.weights import card_of, find_weights, used_path
    from oysterbench.results.card_figures import card_figures

    if version is not None and not VERSION_NAME.fullmatch(version):
        raise click.UsageError(f"--version: expected letters, digits and . _ -, such as 1.0, got {version!r}")
    known = find_weights(name)
    path = path or used_path(name)
    card = card_of(name, path)
    if card is not None and not (version or results or summary or limits or licence):
        return path, card
    training = known.describe(path)
    file = describe_weights(name, path)
    figures = [figure for place in results for figure in card_figures(place, name, file.sha256)]
    words = (summary or known.summary, limits or known.limits, licence or known.licence)
    return path, build_model(name, version or "1.0", known.methods, words, file, training, figures)


@click.command("publish-model", short_help="Publish trained weights in a tree that any web server can serve.")
@click.argument("name", metavar="MODEL")
@click.argument("tree", type=FOLDER, metavar="DIR")
@click.option("--key", "key_file", type=FILE, required=True, help="Private key, from `oysterbench keygen`.")
@click.option("--old-key", "old_files", type=FILE, multiple=True, help="Previous key, which also signs; repeatable.")
@card_options
@click.option("--json", "as_json", is_flag=True, help="Print the card as JSON.")
def publish_model(
    name: str,
    tree: Path,
    key_file: Path,
    old_files: tuple[Path, ...],
    as_json: bool,
    **card: Any,
) -> None:
    """Publish trained weights into a static tree, beside its splits: the file, and a card that says what it was trained
    on, how, and how well it performs.

    \b
    Examples:
      oysterbench run unet --split seg-val --out val
      oysterbench publish-model unet hub --key my-hub.pem --results val
      oysterbench publish-model unet hub --key my-hub.pem \\
        --results val --version 1.1 --weights better.pt

    Weights of another kind, weights from an unfinished training, and results of other weights are refused: each result
    names its weights by their hash.
    """
    from oysterbench.core.permissions import closed_to_others
    from oysterbench.hub.publish_model import publish_model as release
    from oysterbench.hub.sign import load_key, public_hex

    key, old_keys = load_key(key_file), [load_key(file) for file in old_files]
    path, described = release_card(name, **card)
    model = release(tree, described, path, key, message, old_keys)
    if not model.figures:
        message("no --results: the card says that these weights were not evaluated")
    if as_json:
        echo(model.data.decode(), nl=False)
        return
    message(f"{model.name} {model.version}: {model.file.size / 1e6:.1f} MB, {len(model.figures)} figures, in {tree}")
    message(f"public key: {public_hex(key)}")
    if closed := closed_to_others(tree, tree / "index.json"):
        message(closed)
    echo(model.sha256)


def model_path(name: str, out: Path | None) -> Path:
    """Path where a download saves weights: in the folder `out`, or by default where methods look for them."""
    from oysterbench.methods.weights import weights_path

    return weights_path(name) if out is None else out / f"{name}.pt"


def part_of_oysterbench(name: str, version: str) -> Here | None:
    """Weights of this version, or of any where it is empty, that are part of oysterbench; None where there are none, or
    methods run on others, trained or downloaded here."""
    from oysterbench.hub.weights import weights_here
    from oysterbench.methods.weights import used_path

    here = weights_here(used_path(name))
    card = here.model if here is not None and here.released else None
    return here if card is not None and card.name == name and version in ("", card.version) else None


def download_model(hub: Hub, model: Model, out: Path | None, dry_run: bool, again: bool, as_json: bool) -> None:
    """Fetch trained weights, or with dry_run only print what would be fetched."""
    from oysterbench.cli.progress import bytes_bar
    from oysterbench.hub.weights import check_replaced, fetch_weights, there_bytes

    path = model_path(model.name, out)
    row = {"model": model.name, "version": model.version, "file": str(path), "sha256": model.file.sha256}
    size = model.file.size
    if dry_run:
        here = check_replaced(path, model, again)
        state, there = ("here", size) if here else ("to fetch", there_bytes(path, model.file))
        if as_json:
            echo(json.dumps({**row, "state": state, "size_bytes": size, "there_bytes": there}, indent=2))
        else:
            echo(f"{path}: {state}, {size / 1e6:.1f} MB")
            message(f"{model.name} {model.version}: {(size - there) / 1e6:.1f} of {size / 1e6:.1f} MB to fetch")
        return
    if not check_replaced(path, model, again):
        message(f"fetching {hub.described(model)}")
    with bytes_bar(f"downloading {model.name}") as progress:
        fetch_weights(hub, model, path, again, progress)
    if as_json:
        echo(json.dumps(row, indent=2))
    else:
        echo(path)


@click.command(short_help="List trained weights: which exist, which are here, and how good they are.")
@click.argument("name", metavar="[MODEL]", required=False)
@click.option("--hub", "ask_hub", is_flag=True, help="Also ask the hub.")
@click.option("--from", "places", multiple=True, metavar="URL", help="Address or folder of a hub; implies --hub.")
@click.option("--key", help="Public key of the hub.  [default: OYSTERBENCH_HUB_KEY]")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def models(name: str | None, ask_hub: bool, places: tuple[str, ...], key: str | None, as_json: bool) -> None:
    """List trained weights: which are known, which are on this machine, and how long training takes.

    With a MODEL: the card of the local weights or, with --hub, of the newest on the hub.

    \b
    Examples:
      oysterbench models
      oysterbench models --hub
      oysterbench models unet

    Without --hub, no network is used.
    """
    hub = _hub(places, key) if ask_hub or places else None
    if name is not None:
        _print_card(name, hub, as_json)
        return
    rows = _rows(hub)
    if as_json:
        echo(json.dumps({"models": rows}, indent=2))
        return
    from oysterbench.cli.outputs import print_table
    from oysterbench.report.table import Column, Table, TableRow

    columns = (
        Column("model", "model"),
        Column("here", "here"),
        *((Column("hub", "hub"),) if hub else ()),
        Column("methods", "runs in", wide=True),
        Column("takes", "training takes"),
    )
    cells = []
    for row in rows:
        of_hub = (", ".join(row["hub"]) or "no",) if hub else ()
        cells.append((row["model"], row["here"], *of_hub, ", ".join(row["methods"]), row["takes"]))
    print_table(Table("", columns, tuple(map(TableRow, cells))))


def _hub(places: tuple[str, ...], key: str | None) -> Hub:
    from oysterbench.hub.download import Hub
    from oysterbench.hub.settings import NAME_ONE, NO_HUB, hub_key, hub_places

    hub_at = hub_places(places)
    if not hub_at:
        raise HubError(f"{NO_HUB}; {NAME_ONE}")
    return Hub.at(hub_at, hub_key(key), message)


def _rows(hub: Hub | None) -> list[dict[str, Any]]:
    """Rows with what is known about each model, here and on a hub."""
    from oysterbench.hub.weights import weights_here
    from oysterbench.methods.weights import find_weights, used_path, weights_names

    released = hub.index().models if hub else {}
    rows = []
    for name in sorted({*weights_names(), *released}):
        known = find_weights(name) if name in weights_names() else None
        here = weights_here(used_path(name))
        of_hub = released.get(name, {})
        methods = known.methods if known else list(of_hub.values())[-1].methods
        rows.append(
            {
                "model": name,
                "here": f"{_state(name, here)}, {here.path.stat().st_size / 1e6:.1f} MB" if here else "no",
                "file": str(here.path) if here else None,
                "sha256": here.sha256 if here else None,
                "hub": [f"{version} ({release.size / 1e6:.1f} MB)" for version, release in of_hub.items()],
                "methods": list(methods),
                "takes": known.takes if known else "",
            }
        )
    return rows


def _state(name: str, here: Here) -> str:
    """Where weights that are here are from, and whether methods can use them."""
    from oysterbench.methods.weights import check_usable

    try:
        check_usable(name, here.path)
    except MethodError:
        other = here.model is not None and here.model.name != name
        return f"{here.brief} ({'of another kind' if other else 'unfinished or damaged'})"
    return here.brief


def _print_card(name: str, hub: Hub | None, as_json: bool) -> None:
    """Print the card of a model: from the hub, of fetched weights, or made from weights trained here."""
    from oysterbench.hub.card import facts, reached
    from oysterbench.hub.publish_model import build_model, describe_weights
    from oysterbench.methods.weights import card_of, existing, find_weights, used_path

    name, _, version = name.partition("@")
    path = used_path(name)
    if hub is not None:
        model = hub.model(name, version or None)
    elif version:
        raise MethodError(f"{name}@{version}: local weights have one version; add --hub for a version on a hub")
    elif (card := card_of(name, path)) is not None:
        model = card
    else:
        known = find_weights(name)
        training = known.describe(existing(name, path))
        words = (known.summary, known.limits, known.licence)
        model = build_model(name, "trained here", known.methods, words, describe_weights(name, path), training)
    if as_json:
        echo(model.data.decode(), nl=False)
        return
    echo(f"{model.name} {model.version}")
    for key, value in facts(model).items():
        echo(f"  {key}: {value}")
    for figure in model.figures:
        echo(f"  {figure.method} on {figure.split or 'own data'}: {figure.heading} {reached(figure)}")


COMMANDS = (publish_model, models)
