"""What is installed is what there is: every package is named in pyproject.toml, and every file that one reads."""

from __future__ import annotations

import json
import re
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.version import Version

from oysterbench.version import VERSION
from tests.helpers.paths import ROOT

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SETUPTOOLS = PYPROJECT["tool"]["setuptools"]
ADVISORIES = tomllib.loads((ROOT / ".ci" / "advisories.toml").read_text())["advisory"]
LICENCES = PYPROJECT["project"]["license"].split(" AND ")
READ_IN_THE_CHECKOUT_ONLY = ("datasets/pictures/*",)


def packages() -> dict[str, Path]:
    """Name -> folder of every package of the tree."""
    found = {}
    for name, folder in SETUPTOOLS["package-dir"].items():
        for path in (ROOT / folder).rglob("__init__.py"):
            found[".".join([name, *path.parent.relative_to(ROOT / folder).parts])] = path.parent
    return found


def test_every_package_is_installed():
    assert sorted(SETUPTOOLS["packages"]) == sorted(packages())


@pytest.mark.parametrize("name", sorted(packages()))
def test_every_file_of_a_package_is_installed(name):
    known = packages()
    patterns = [*SETUPTOOLS["package-data"].get(name, []), *SETUPTOOLS["package-data"]["*"], "*.py"]
    for path in known[name].rglob("*"):
        nearest = next(folder for folder in path.parents if folder in known.values())
        if not path.is_file() or nearest != known[name] or "__pycache__" in path.parts:
            continue
        if any(path.relative_to(ROOT).match(pattern) for pattern in READ_IN_THE_CHECKOUT_ONLY):
            continue
        where = str(path.relative_to(known[name]))
        assert any(fnmatch(where, pattern) for pattern in patterns), f"{path} is not in the package-data of {name}"


@pytest.mark.parametrize("advisory", ADVISORIES, ids=lambda advisory: advisory["id"])
def test_no_version_with_a_known_hole_may_be_installed(advisory):
    project = PYPROJECT["project"]
    texts = [*PYPROJECT["build-system"]["requires"], *project["dependencies"]]
    texts += [text for extra in project["optional-dependencies"].values() for text in extra]
    asked = [found for found in map(Requirement, texts) if found.name == advisory["name"]]
    assert asked, f"{advisory['name']} is not asked for any more: take {advisory['id']} out of .ci/advisories.toml"
    for requirement in asked:
        least = max((Version(part.version) for part in requirement.specifier if part.operator == ">="), default=None)
        assert least is not None, f"{requirement} has no minimum"
        assert least >= Version(advisory["fixed"]), f"{requirement}: {advisory['id']} is fixed in {advisory['fixed']}"


def test_the_citation_the_changelog_and_the_package_are_of_one_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == VERSION
    assert citation["license"] == LICENCES[0] == "MIT"  # that of the software
    first = re.search(r"^## \[([\d.]+)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert first is not None
    assert first[1] == VERSION


def test_the_licences_of_the_weights_and_of_what_they_began_with_go_with_the_package():
    card = json.loads((ROOT / "datasets" / "models" / "unet.json").read_text())
    assert card["licence"] == "https://creativecommons.org/licenses/by/4.0/"
    assert card["training"]["begun"]["licence"].startswith("Apache License 2.0")
    assert LICENCES == ["MIT", "CC-BY-4.0", "Apache-2.0"]
    with_it = {
        str(path.relative_to(ROOT)) for text in PYPROJECT["project"]["license-files"] for path in ROOT.glob(text)
    }
    assert with_it == {"LICENSE", "LICENSES/Apache-2.0.txt", "LICENSES/NOTICE.txt"}
    assert card["training"]["begun"]["source"] in (ROOT / "LICENSES" / "NOTICE.txt").read_text()


def test_the_page_on_the_package_index_has_no_links_that_lead_nowhere_there():
    text = (ROOT / PYPROJECT["project"]["readme"]).read_text()
    assert all(target.startswith("https://") for target in re.findall(r"\]\(([^)]*)\)", text))
