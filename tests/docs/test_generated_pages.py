"""Each command, option, topic, metric and recipe key is in the pages that are generated from the code."""

from __future__ import annotations

import dataclasses
import importlib
import re

import click
import pytest

from docs.generate import generated_pages
from docs.generate.commands import all_commands
from docs.generate.docstrings import as_markdown
from docs.generate.fields import told_fields
from docs.generate.recipes import recipe_tables
from docs.generate.splits import split_facts
from oysterbench.evaluate.metrics import TRACKS
from oysterbench.hub.manifest import released_manifest
from oysterbench.recipe import LampRecipe, RigRecipe, SplitRecipe, load_split, split_names
from oysterbench.recipe.keys import number
from oysterbench.sensors.registry import sensor_kinds
from oysterbench.sequence.truth import rig_topics
from oysterbench.simulation import cost
from oysterbench.version import GENERATION, VERSION
from tests.helpers.paths import ROOT


@pytest.fixture(scope="module")
def pages():
    return generated_pages()


def section(page, heading):
    """The text below a heading, as far as the next heading of any level."""
    assert f"{heading}\n" in page, heading
    return re.split(r"^#+ ", page.split(f"{heading}\n", 1)[1], maxsplit=1, flags=re.M)[0]


def test_every_command_has_a_section_with_each_of_its_options(pages):
    commands = all_commands()
    assert {"oysterbench eval slam", "oysterbench leaderboard serve", "oysterbench train unet"} <= {
        context.command_path for context in commands
    }
    for context in commands:
        text = section(pages["reference/commands.md"], f"# {context.command_path}")
        for item in context.command.params:
            if isinstance(item, click.Option) and not item.hidden:
                for name in item.opts:
                    assert re.search(rf"^\| `[^`]*{re.escape(name)}\b", text, re.M), (context.command_path, name)


def test_every_metric_is_defined_under_its_track(pages):
    page = pages["reference/metrics.md"]
    for name, track in TRACKS.items():
        text = section(page, f"{{ #{name} }}")
        for key, metric in track.metrics.items():
            row = next(line for line in text.splitlines() if line.startswith(f"| `{key}` "))
            assert " ".join(metric.definition.split()).replace("|", "&#124;").rstrip(".") in row


def test_every_key_of_a_recipe_is_in_the_table_of_its_block(pages):
    tables = dict(recipe_tables(SplitRecipe))
    assert {"", "sequence", "sequence.water.plumes", "sequence.path", "steering"} <= set(tables)
    for name, kind in tables.items():
        text = section(pages["reference/recipe.md"], f"{{ #{name.replace('.', '-') or 'file'} }}")
        for field in dataclasses.fields(kind):
            assert f"| `{field.name}` |" in text or field.name in ("source", "rig_source"), (name, field.name)


def test_every_key_that_a_shipped_recipe_states_is_in_a_table(pages):
    stated = set(re.findall(r"^(\w+) = ", "".join(load_split(name).source for name in split_names()), re.M))
    assert {key for key in stated if f"| `{key}` |" not in pages["reference/recipe.md"]} == set()


def test_every_key_of_a_rig_is_in_the_table_of_its_block(pages):
    kinds = {block: kind.recipe for block, kind in sensor_kinds().items()} | {"lamp": LampRecipe, "file": RigRecipe}
    for name, kind in kinds.items():
        text = section(pages["reference/rig.md"], f"{{ #{name.replace('_', '-')} }}")
        for field in dataclasses.fields(kind):
            assert f"| `{field.name}` |" in text or field.name == "sensors", (name, field.name)


def test_a_key_is_told_with_its_range_default_and_comment(pages):
    assert "| `depth_m` | number | 0.5 to 60 | required | mean depth of the bottom |" in pages["reference/recipe.md"]
    assert "| `repeats` | number | 0 to 0.5 | `0` | share of frames that repeat" in pages["reference/rig.md"]
    assert "| `max_pitch_deg` | number | 0 to 80 | `30` | Steepest climb and descent. |" in pages["reference/recipe.md"]


def test_every_topic_of_every_rig_is_listed_with_its_type(pages):
    page = pages["reference/topics.md"]
    for split in map(load_split, split_names()):
        names = "|".join(sensor.name for sensor in (*split.rig.sensors, *split.rig.camera) if not sensor.single)
        for topic, kind in rig_topics(split.rig).items():
            generic = re.sub(f"^/({names})/", "/NAME/", topic)
            assert re.search(rf"^\| `{generic}` \|[^|]*\| `{kind}` \|", page, re.M), topic


def test_every_split_has_a_row(pages):
    for name in split_names():
        assert f"| `{name}` |" in pages["reference/splits.md"]


def test_every_version_is_that_of_the_code(pages):
    page = pages["reference/evaluators.md"]
    assert f"| library | `oysterbench` | `{VERSION}` |" in page
    assert f"| rendering | `generation` | `{GENERATION}` |" in page
    assert "| evaluator | `slam` | `slam " in page


def test_the_citation_is_that_of_the_file(pages):
    assert f'version: "{VERSION}"' in (ROOT / "CITATION.cff").read_text()
    assert f"version = {{{VERSION}}}" in pages["citing.md"]


def test_comments_above_behind_and_below_a_field_are_read():
    found = {told.field.name: told.text for told in told_fields(Told)}
    assert found == {"above": "Of two lines.", "behind": "of one", "below": "As text.", "bare": ""}


@dataclasses.dataclass
class Told:
    # Of two
    # lines.
    above: float = number(0, 1, 0.0)
    behind: int = 3  # of one
    below: int = 4
    """As text."""
    bare: int = 5


def test_the_readme_has_the_sizes_of_the_recipes():
    readme = (ROOT / "README.md").read_text()
    for facts in split_facts():
        rows = [line for line in readme.splitlines() if line.startswith(f"| {facts.name} |")]
        if not rows:  # those framed like real pictures share a row
            assert f"-{facts.name.partition('-')[2]}" in readme
            continue
        _, _, _, size, _, hours, _ = (cell.strip() for cell in rows[0].split("|"))
        number_, unit = size.split()
        expected = facts.minutes if unit == "min" else facts.images
        assert float(number_) == pytest.approx(expected, rel=0.15)
        assert float(hours) == pytest.approx(facts.cpu_h, rel=0.4), facts.name


UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "MB": 1e6, "GB": 1e9}


def quantity(text):
    """Value of a cell such as "2.4 min", in s or bytes."""
    number_, unit = text.split()
    return float(number_) * UNITS[unit]


def test_the_page_of_the_splits_has_the_sizes_of_the_manifests_and_the_estimates_of_the_command():
    lines = (ROOT / "datasets" / "README.md").read_text().splitlines()
    rows = {line.split("|")[1].strip(): line.split("|")[2:-1] for line in lines if line.startswith(("| s", "|s"))}
    for facts in split_facts():
        *_, size, cpu, both = (cell.strip() for cell in rows[facts.name])
        assert quantity(cpu) == pytest.approx(3600 * facts.cpu_h, rel=0.1), facts.name
        assert quantity(both) == pytest.approx(1800 * facts.cpu_h, rel=0.15), facts.name
        manifest = released_manifest(facts.name, facts.version)
        if manifest is not None:
            assert quantity(size) == pytest.approx(manifest.size, abs=0.5e6 if "MB" in size else 0.05e9), facts.name


@pytest.mark.parametrize("name", [name for name in split_names() if name != "slam-stress"])
def test_the_table_of_a_split_has_the_estimates_of_the_command(name):
    split = load_split(name)
    text = section((ROOT / "datasets" / "README.md").read_text(), f"### {name}")
    unit = 60.0 if "CPU min |" in text else 1.0
    found = {line.split("|")[1].strip(): line.split("|")[-2].strip() for line in text.splitlines() if "|" in line}
    for sequence in split.sequence:
        assert found[sequence.name] == f"{cost.estimated(split, sequence) / unit:.0f}", sequence.name


def test_what_a_command_prints_below_its_options_is_text_or_a_listing(pages):
    page = pages["reference/commands.md"]
    assert "\n\nData is kept in the folder that OYSTERBENCH\\_HOME names" in page
    assert "```\nFormats of a sequence:" in page.replace("```text", "```")


def test_the_constants_of_image_formation_are_those_of_the_code():
    page = (ROOT / "docs" / "concepts" / "images.md").read_text()
    rows = re.findall(r"^\| `([A-Z_]+)` \| `([\w.]+)` \| ([\d.]+) \|", page, re.M)
    assert len(rows) > 15
    for name, module, value in rows:
        assert float(getattr(importlib.import_module(module), name)) == pytest.approx(float(value)), name


def test_the_layout_of_a_docstring_becomes_markdown():
    text = "Title.\n\n>>> 1 + 1\n2\n\na:  first,\n    and more\nb, c: (N,) m\n\nPlain: text\nof two lines."
    example = "```pycon\n>>> 1 + 1\n2\n```"
    listed = "- `a`: first,\n    and more\n- `b, c`: (N,) m"
    assert as_markdown(text) == f"Title.\n\n{example}\n\n{listed}\n\nPlain: text\nof two lines."
    section = "Title.\n\nExamples\n--------\n>>> 1\n1\n"
    assert as_markdown(section) == section
