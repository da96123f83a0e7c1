"""SegFormer reads the folder of images as it is; its options go to `segment.py`."""

from __future__ import annotations

import json

from oysterbench.core.helpers import module_command
from oysterbench.methods.systems.launch import Launch


def command(launch: Launch) -> list[str]:
    """Write the options as JSON, and return the command line, which runs in the environment that has transformers."""
    task = {**launch.options, "instances": launch.about.track == "detection"}
    weights = task.pop("weights")  # identified by their content, not by their path
    (launch.folder / "task.json").write_text(json.dumps(task, indent=1), encoding="utf-8")
    words = (launch.folder / "task.json", weights, launch.given, launch.out)
    python = launch.build.parent / "venv" / "bin" / "python"
    return module_command(f"{__package__}.segment", *words, python=python)
