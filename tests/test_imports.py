"""The import directions of the design, held by reading every import in the tree."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.helpers.paths import ROOT

GROUND = {"errors", "files", "version", "geometry", "trajectory", "samples", "streams", "recipe", "ply"}
"""Rooms that everything may stand on; among themselves they import only what is listed before them."""

MAY_IMPORT = {
    "version": set(),
    "errors": set(),
    "files": set(),
    "streams": set(),
    "geometry": {"errors"},
    "trajectory": {"errors", "files", "geometry"},
    "samples": {"geometry"},
    "ply": {"errors", "files"},
    "recipe": {"errors"},
    "scene": GROUND,
    "render": GROUND | {"scene"},
    "sensors": GROUND | {"scene", "render"},
    "sequence": GROUND,
    "calibration": GROUND | {"scene", "sensors"},
    "view": GROUND | {"sequence", "page"},
    "stage": GROUND | {"scene", "render", "sensors"},
    "recording": GROUND | {"scene", "calibration", "sensors", "sequence", "stage"},
    "steering": GROUND | {"scene", "render", "sensors", "sequence", "stage", "methods", "evaluate"},
    "salt": {"errors"},
    "scheduling": {"errors"},
    "generate": GROUND | {"calibration", "render", "sequence", "stage", "recording", "salt", "scheduling", "steering"},
    "gallery": GROUND | {"stage"},
    "methods": GROUND | {"sequence"},
    "mapping": GROUND | {"sequence"},
    "cli_map": GROUND | {"mapping", "density", "sequence"},
    "labelled": GROUND | {"sequence"},
    "density": GROUND | {"sequence", "mapping", "labelled", "answers", "evaluate", "page"},
    "surveys": GROUND
    | {
        "sequence",
        "mapping",
        "density",
        "generate",
        "conditions",
        "evaluate",
        "results",
        "report",
        "tracks",
        "imaging",
        "answers",
        "methods",
    },
    "exploring": GROUND
    | {
        "sequence",
        "generate",
        "methods",
        "conditions",
        "evaluate",
        "results",
        "report",
        "density",
        "plots",
        "render",
        "salt",
        "scheduling",
        "steering",
    },
    "evaluate": GROUND,
    "answers": GROUND | {"sequence", "labelled", "evaluate"},
    "imaging": GROUND
    | {"sequence", "labelled", "generate", "methods", "conditions", "evaluate", "answers", "results", "report"},
    "conditions": GROUND | {"render"},
    "results": GROUND | {"evaluate"},
    "comparison": GROUND | {"evaluate", "results"},
    "page": GROUND,
    "plots": GROUND,
    "report": GROUND | {"evaluate", "results", "comparison", "page", "plots"},
    "tracks": GROUND | {"sequence", "generate", "methods", "conditions", "evaluate", "results", "report"},
    "running": GROUND | {"sequence", "generate", "methods", "evaluate", "results", "report", "tracks"},
    "cli_outputs": {"errors", "files", "report", "results"},
    "cli_run": GROUND
    | {"cli_outputs", "cli_render", "cli_scoring", "evaluate", "generate", "methods", "report", "results", "running"},
    "cli_imaging": GROUND
    | {"cli_outputs", "cli_render", "evaluate", "generate", "imaging", "methods", "report", "results"},
    "cli_density": GROUND
    | {
        "cli_map",
        "cli_outputs",
        "cli_render",
        "density",
        "surveys",
        "answers",
        "imaging",
        "evaluate",
        "generate",
        "methods",
        "report",
        "results",
        "running",
        "sequence",
    },
    "cli_steering": GROUND
    | {"cli_outputs", "cli_render", "comparison", "evaluate", "exploring", "generate", "methods", "report", "results"}
    | {"salt"},
    "cli_compare": {"errors", "cli_outputs", "results", "comparison", "report"},
    "hub": GROUND | {"sequence", "page"},
    "cli_hub": GROUND | {"generate", "hub", "salt"},
    "cli_learn": {"errors"},
    "cli_labelled": GROUND | {"labelled", "cli_render", "conditions"},
    "cli_reading": {"trajectory", "geometry"},
    "cli_render": GROUND | {"gallery", "generate", "salt"},
    "cli_splits": GROUND | {"cli_outputs", "generate", "hub"},
    "cli_scoring": {"evaluate"},
    "cli": GROUND
    | {
        "cli_compare",
        "cli_map",
        "cli_density",
        "cli_imaging",
        "cli_outputs",
        "cli_hub",
        "cli_splits",
        "cli_steering",
        "cli_learn",
        "cli_reading",
        "cli_render",
        "cli_run",
        "running",
        "cli_scoring",
        "comparison",
        "sequence",
        "generate",
        "methods",
        "evaluate",
        "results",
        "report",
        "tracks",
        "gallery",
        "scene",
        "view",
    },
    "": {"sequence", "version"},
}
"""Room of oysterbench (module or folder; "" is `oysterbench/__init__.py`) -> rooms that it may import."""

HOMES = {
    "warp": ("oysterbench/scene", "oysterbench/render", "oysterbench/sensors", "tests"),
    "trimesh": ("oysterbench/scene", "oysterbench/render", "oysterbench/sensors", "tests"),
    "gtsam": ("baselines", "tests"),
    "torch": ("baselines", "tests"),
    "starlette": ("oysterbench/hub/serve.py", "leaderboard", "tests"),
    "uvicorn": ("oysterbench/hub/serve.py", "leaderboard", "tests"),
    "cryptography": ("oysterbench/hub", "leaderboard", "tests"),
    "evo": ("tests",),
    "oysterbench_baselines": ("baselines", "leaderboard", "tests"),
    "oysterbench_leaderboard": ("leaderboard", "tests"),
}
"""Packages that live in some folders only."""

SOURCES = sorted(
    path for folder in ("oysterbench", "baselines", "leaderboard", "tests") for path in (ROOT / folder).rglob("*.py")
)


def imported(path: Path) -> set[str]:
    """Absolute names of the modules that a file imports, at its top or inside a function."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def room(path: Path) -> str:
    """Room of a file of the library."""
    parts = path.relative_to(ROOT / "oysterbench").with_suffix("").parts
    return "" if parts == ("__init__",) else parts[0]


def test_sources_are_found():
    assert len(SOURCES) > 20


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_point_one_way(path):
    where = path.relative_to(ROOT)
    for name in imported(path):
        package, *rest = name.split(".")
        if package in HOMES:
            assert str(where).startswith(HOMES[package]), f"{where} imports {name}"
        if package == "oysterbench" and where.parts[0] == "oysterbench" and rest:
            here = room(path)
            assert here in MAY_IMPORT, f"{where}: say in MAY_IMPORT which rooms {here!r} may import"
            assert rest[0] in MAY_IMPORT[here] | {here}, f"{where} imports {name}"


def test_sequence_reading_knows_nothing_of_how_sequences_are_made():
    for path in (ROOT / "oysterbench" / "sequence").glob("*.py"):
        assert not any(name.startswith(("oysterbench.scene", "oysterbench.render")) for name in imported(path))


def test_baselines_use_the_public_library_only():
    for path in (ROOT / "baselines").rglob("*.py"):
        for name in imported(path):
            assert "._" not in name
            assert not name.startswith(
                ("oysterbench.scene", "oysterbench.render", "oysterbench.simulation.generate")
            ), name
