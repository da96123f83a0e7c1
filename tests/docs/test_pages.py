"""The pages that are written by hand: they name commands, options and files that there are."""

from __future__ import annotations

import re
import shlex

import click
import pytest

from docs.generate import generated_pages
from docs.generate.commands import all_commands
from docs.generate.repository import repository_pages, site_links
from oysterbench.cli.main import main
from oysterbench.recipe.path import PATH_KINDS, PathRecipe
from oysterbench.sensors.registry import sensor_kinds
from oysterbench.sequence.truth import rig_topics
from tests.helpers.paths import ROOT
from tests.sequence.test_messages import rig_of_every_kind

DOCS = ROOT / "docs"
PAGES = [*sorted(DOCS.rglob("*.md")), ROOT / "README.md"]
PATHS = sorted((DOCS / "paths").glob("*.sh"))
MOST_COMMANDS = 6


def lines_of_commands(text):
    """Lines of blocks of code that begin with a command of ours, without prompts, comments and redirections."""
    for language, block in re.findall(r"^```(\w*)[^\n]*\n(.*?)^```", text, re.M | re.S):
        for line in block.replace("\\\n", " ").splitlines():
            if line.startswith("oysterbench ") and language in ("", "bash", "text"):
                yield line


def check_command(line):
    """Fail unless each word that names a command or an option is one that there is."""
    words = shlex.split(re.split(r" {2,}#| +# |[|&>]|\.\.\.", line)[0])[1:]
    command, context = main, click.Context(main, info_name="oysterbench", **main.context_settings)
    while words and isinstance(command, click.Group) and not words[0].startswith("-"):
        command = command.get_command(context, words.pop(0))
        assert command is not None, line
        context = click.Context(command, parent=context)
    known = {name for item in command.get_params(context) for name in (*item.opts, *item.secondary_opts)}
    if getattr(command, "name", "") == "eval":
        known = {name for each in all_commands() if " eval" in each.command_path for name in options(each)} | {
            "--track"
        }
    assert {word.partition("=")[0] for word in words if re.match(r"--\w", word)} <= known, line


def options(context):
    return {name for item in context.command.get_params(context) for name in item.opts}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_commands_of_a_page_are_commands_that_there_are(page):
    for line in lines_of_commands(page.read_text()):
        check_command(line)


def test_a_command_that_there_is_not_would_be_found():
    with pytest.raises(AssertionError):
        check_command("oysterbench evaluate slam")
    with pytest.raises(AssertionError):
        check_command("oysterbench run gtsam_vi --splits slam-val")


def test_the_pages_name_every_command():
    text = (DOCS / "commands.md").read_text()
    for name in main.list_commands(click.Context(main, **main.context_settings)):
        assert f"oysterbench {name}" in text, name


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_a_path_has_few_commands_all_of_which_there_are(path):
    commands = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    assert len(commands) <= MOST_COMMANDS
    for line in commands:
        for part in line.split("&&"):
            if part.strip().startswith("oysterbench "):
                check_command(part.strip())
    assert any(f'"docs/paths/{path.name}"' in page.read_text() for page in (DOCS / "paths").glob("*.md"))


@pytest.mark.parametrize("page", sorted((DOCS / "paths").glob("*.md")), ids=lambda page: page.stem)
def test_no_two_runs_of_a_path_leave_their_results_in_one_folder(page):
    """The second one would be refused."""
    text = re.sub(r'--8<-- "([\w./]+\.sh)"', lambda found: (ROOT / found[1]).read_text(), page.read_text())
    runs = [shlex.split(line) for line in lines_of_commands(text) if line.startswith("oysterbench run ")]
    folders = [words[words.index("--out") + 1] for words in runs if "--out" in words]
    assert len(folders) == len(set(folders)), folders


def test_what_a_page_shows_of_the_network_is_its_class():
    shown = re.search(r'"docs/paths/my_net\.py:(\d+):(\d+)"', (DOCS / "paths" / "segmentation.md").read_text())
    assert shown is not None
    first, last = map(int, shown.groups())
    lines = (DOCS / "paths" / "my_net.py").read_text().splitlines()[first - 1 : last]
    assert f'--8<-- "docs/paths/my_net.py:{first}:{last}"' in (DOCS / "paths" / "segmentation.md").read_text()
    assert lines[0] == "class MyNet:"
    assert lines[-1].lstrip().startswith("yield Segmentation(")


def test_every_link_of_a_page_leads_to_a_file_in_the_repository():
    generated = {DOCS / place for place in generated_pages()}
    dead = []
    for page in [*PAGES, *repository_pages().values()]:
        for target in re.findall(r"\]\(([^()\s]+)\)", re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)):
            path = target.partition("#")[0]
            if not path or re.match(r"\w+:", path):
                continue
            found = (page.parent / path).resolve()
            if not found.exists() and found not in generated:
                dead.append(f"{page.relative_to(ROOT)}: {target}")
    assert dead == []


def test_every_page_is_in_the_navigation():
    nav = (ROOT / "mkdocs.yml").read_text().partition("\nnav:")[2]
    places = [str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")]
    places += [*generated_pages(), *repository_pages()]
    assert [place for place in places if not re.search(rf"(- |: ){re.escape(place)}$", nav, re.M)] == []


def test_links_between_folders_become_links_between_pages():
    wanted = []
    text = (
        "[a](../unet/README.md#how) [b](../learning/novelty.py) `[c](d.md)` ![f](../../datasets/pictures/rollouts.jpg)"
    )
    got = site_links(text, "baselines/gtsam_vi/README.md", wanted.append)
    assert got.startswith("[a](../unet/README.md#how) b (`baselines/learning/novelty.py`) `[c](d.md)` ")
    assert wanted == ["datasets/pictures/rollouts.jpg"]
    assert site_links("[x](../../datasets/README.md)", "paths/slam.md", wanted.append) == "[x](../datasets/README.md)"


def test_every_kind_of_path_and_each_of_its_keys_is_told():
    text = (DOCS / "recipes.md").read_text()
    names = (*PATH_KINDS, *sorted(PathRecipe.__dataclass_fields__))
    assert [name for name in names if f"`{name}`" not in text] == []


def test_the_page_of_sequences_names_every_sensor_and_how_it_is_read():
    text = (DOCS / "sequences.md").read_text()
    rig = rig_of_every_kind()
    names = "|".join(sensor.name for sensor in (*rig.sensors, *rig.camera) if not sensor.single)
    for kind in sensor_kinds().values():
        assert re.search(rf"^\| .*{kind.title.removesuffix(' sensor')}.* \|", text, re.M), kind.title
        assert not kind.reader or f"`{kind.reader}(" in text, kind.title
    for topic in set(rig_topics(rig)) - {"/tf_static"}:
        generic = re.sub(f"^/({names})/", "/NAME/", topic)
        leaf = topic.rsplit("/")[-1]
        assert f"`{generic}`" in text or leaf in ("class", "instance"), topic


def test_the_readme_fits_a_screen_and_a_half():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 95


def test_pages_hold_no_tabs():
    assert [page for page in PAGES if "\t" in page.read_text()] == []
