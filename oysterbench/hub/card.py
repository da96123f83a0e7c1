"""A model card for people: the same facts on a page and on a terminal."""

from __future__ import annotations

import json

from oysterbench.core.html import render
from oysterbench.hub.model import Figure, Model
from oysterbench.hub.pages import human


def facts(model: Model) -> dict[str, str]:
    """Facts about a model: heading -> text."""
    training = model.training
    data = [f"{name} (SHA-256 {digest[:12]}…)" for name, digest in training.data.items()]
    processor = "processor" if training.device == "cpu" else f"processor, beside a GPU ({training.device})"
    return {
        "What it is": f"{model.summary}.",
        "Runs in": ", ".join(model.methods) or "no method of its own",
        "Not for": model.limits,
        "Trained on": ", ".join(data),
        "Initialised from": "random weights"
        if training.begun is None
        else f"{training.begun.what}; {training.begun.licence}; {training.begun.source}",
        "Training": f"{training.steps} steps, seed {training.seed}, {duration(training.cpu_s)} of a {processor}, loss "
        f"{training.loss:.3g} at the end",
        "Size": f"{training.parameters:,} parameters, {human(model.file.size)}",
        "SHA-256": model.file.sha256,
        "Licence of the weights": model.licence,
        "Made with": ", ".join(f"{name} {version}" for name, version in training.versions.items()),
    }


def reached(figure: Figure) -> str:
    """Value of a figure with its unit, and the confidence interval where there is one."""
    unit = f" {figure.unit}" if figure.unit else ""
    if figure.low is None or figure.high is None:
        return f"{figure.value:.3f}{unit}"
    return f"{figure.value:.3f}{unit} ({figure.low:.3f} to {figure.high:.3f})"


def duration(seconds: float) -> str:
    """Format the duration of a computation, in s, for people.

    >>> duration(40), duration(480), duration(9000)
    ('40 s', '8 min', '2.5 h')
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def card_page(model: Model) -> str:
    """Render the card as an HTML page; its links are relative to the folder `cards` of the tree."""
    context = {
        "model": model,
        "facts": facts(model),
        "figures": [(figure, reached(figure)) for figure in model.figures],
        "settings": json.dumps(model.training.settings, indent=1, sort_keys=True),
    }
    return render("card.html", context, "oysterbench.hub")
