"""A class is known by its code: by which files, and that a run or a count of other code is not taken for its own."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from dataclasses import replace
from importlib import invalidate_caches
from zipfile import ZipFile

import pytest

from oysterbench.core.errors import MethodError
from oysterbench.counting.identity import method_identity
from oysterbench.exploration import rollout_store
from oysterbench.methods import runner
from oysterbench.methods.adapters import PythonMethod
from oysterbench.methods.code import code_digests, file_digest
from oysterbench.methods.finding import find_method
from oysterbench.methods.outcomes import Job, Outcome, read_outcome
from oysterbench.tracks.slam import SlamSequence

NET = """
class Net:
    name, track = "net", "slam"

    def run(self, sequence):
        import coded_helper
"""
BARE = NET.replace("import coded_helper", "return None")
FILES = {
    "coded.py": NET,
    "coded_helper.py": "from coded_nets import blocks\n",
    "coded_nets/blocks.py": "from . import layers\nimport oysterbench, numpy\n",
    "coded_nets/layers.py": "import coded_package.deep\n",
    "coded_package/__init__.py": "",
    "coded_package/deep.py": NET,
    "coded_package/inner/other.py": "",
    "coded_unrelated.py": "",
    "coded_nets/unrelated.py": "",
    "oysterbench/__init__.py": "",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with methods and what they import, after all other places on Python's path."""
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [*sys.path])
    invalidate_caches()
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("coded")]:
        del sys.modules[name]


def change(path, text="# other\n"):
    before = path.stat().st_mtime_ns
    path.write_text(path.read_text() + text)
    os.utime(path, ns=(before + 10**9, before + 10**9))


def test_rollouts_are_not_those_of_a_changed_file_that_an_option_names(folder):
    (folder / "tabled.py").write_text(
        "class Net:\n    name, track = 'net', 'steering'\n"
        "    def __init__(self, table: str = ''): ...\n    def run(self, view): ...\n"
    )
    (folder / "table.csv").write_text("1")
    reference = f"tabled:Net[table={folder / 'table.csv'}]"
    before = rollout_store.method_identity(reference)
    assert rollout_store.method_identity(reference) == before
    (folder / "table.csv").write_text("22")
    assert rollout_store.method_identity(reference) != before


@pytest.mark.parametrize(
    ("reference", "files"),
    [
        ("coded:Net[size=4]", {name for name in FILES if "unrelated" not in name and "oysterbench" not in name}),
        ("coded_package.deep:Net", {name for name in FILES if name.startswith("coded_package/")}),
        ("dead_reckoning", set()),
        ("no_such_module:Net", set()),
        ("builtins:object", set()),
    ],
)
def test_a_class_is_known_by_its_package_or_its_file_and_what_that_imports_from_beside_it(reference, files, folder):
    assert set(code_digests(reference)) == files


def test_of_an_installed_module_nothing_beside_it_belongs_to_it(tmp_path, monkeypatch):
    folder = tmp_path / "site-packages"
    folder.mkdir()
    (folder / "coded_installed.py").write_text("import coded_beside\n")
    (folder / "coded_beside.py").write_text("")
    monkeypatch.syspath_prepend(folder)
    assert set(code_digests("coded_installed:Net")) == {"coded_installed.py"}


def test_a_result_is_not_that_of_changed_code(folder, dive_file, tmp_path):
    job, root = job_of(dive_file), tmp_path / "out"
    write_outcome(job, root)
    ((_, kept),) = runner.run_jobs([job], root)
    assert kept.earlier
    change(folder / "coded_unrelated.py")
    list(runner.run_jobs([job], root))
    change(folder / "coded_helper.py")
    change(folder / "coded_nets/layers.py", "import coded_unrelated")
    changed = "coded_helper.py, coded_nets/layers.py, coded_unrelated.py changed"
    with pytest.raises(MethodError, match=rf"holds run 1 of a different net \({changed}\); .*rerun it with --again"):
        list(runner.run_jobs([job], root))


def test_what_failed_is_run_again_once_its_code_has_changed(folder, dive_file, tmp_path, monkeypatch):
    job, root = job_of(dive_file), tmp_path / "out"
    write_outcome(job, root, failure="method 'net' failed")
    monkeypatch.setattr(runner, "_run", lambda jobs, *others: iter([(one, "run again") for one in jobs]))
    ((_, kept),) = runner.run_jobs([job], root)
    assert kept.failure == "method 'net' failed"
    change(folder / "coded.py")
    assert list(runner.run_jobs([job], root)) == [(job, "run again")]


def test_a_result_whose_code_was_not_recorded_is_not_said_to_be_of_changed_code(folder, dive_file, tmp_path):
    job, root = job_of(dive_file), tmp_path / "out"
    write_outcome(job, root)
    kept = read_outcome(job.folder(root))
    method = {key: value for key, value in kept.identity["method"].items() if key != "files"}
    replace(kept, identity={**kept.identity, "method": method}).write(job.folder(root))
    with pytest.raises(MethodError, match=r"a different net \(an earlier version of oysterbench did not record"):
        list(runner.run_jobs([job], root))


def job_of(dive_file):
    return Job(PythonMethod("coded:Net"), SlamSequence("hand-made", dive_file), 0, 60.0)


def write_outcome(job, root, failure=None):
    cost = {"wall_s": 1.0, "cpu_s": 1.0, "peak_bytes": 1, "left_behind": 0}
    outcome = Outcome(job.identity, failure, 1.0, 1.0, cost, [], 60.0, {}, {}, "", "")
    outcome.write(job.folder(root))


def test_counts_and_rollouts_are_not_those_of_changed_code(folder):
    def identities():
        return method_identity("coded:Net", find_method("coded:Net"), {}), rollout_store.method_identity("coded:Net")

    before = identities()
    change(folder / "coded_unrelated.py")
    assert identities() == before
    change(folder / "coded_helper.py")
    assert all(now != was for now, was in zip(identities(), before, strict=True))


@pytest.mark.parametrize(
    ("reference", "files"),
    [
        (
            "coded_research:Net",
            {"coded_research.py", "coded_models/__init__.py", "coded_models/net.py", "coded_utils.py"},
        ),
        ("coded_models.net:Net", {"coded_models/__init__.py", "coded_models/net.py"}),
    ],
)
def test_what_a_package_imports_from_beside_it_counts_if_it_is_itself_imported(reference, files, folder):
    (folder / "coded_research.py").write_text("from coded_models import net\n" + BARE)
    (folder / "coded_models").mkdir()
    (folder / "coded_models" / "net.py").write_text("import coded_utils\n" + BARE)
    for name in ("__init__.py", "coded_models/__init__.py", "coded_utils.py"):  # the first makes the folder no package
        (folder / name).write_text("")
    assert set(code_digests(reference)) == files


def test_of_a_package_only_what_python_can_import_counts(folder):
    before = code_digests("coded_package.deep:Net")
    package = folder / "coded_package"
    (package / ".#deep.py").symlink_to("someone@host.1234")  # an editor's lock
    for name in (
        ".ipynb_checkpoints/deep.py",
        "venv/lib/python3.11/site-packages/a.py",
        "__pycache__/a.py",
        "._deep.py",
    ):
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text("")
    assert code_digests("coded_package.deep:Net") == before


def test_a_class_in_a_zip_archive_is_known_by_the_archive(tmp_path, monkeypatch):
    archive = tmp_path / "coded.zip"
    monkeypatch.syspath_prepend(archive)
    with ZipFile(archive, "w") as file:
        file.writestr("coded_zipped.py", NET)
    try:
        assert PythonMethod("coded_zipped:Net").identity["files"] == {"coded.zip": file_digest(archive)}
    finally:
        sys.modules.pop("coded_zipped", None)


def test_what_an_option_says_may_be_longer_than_a_name_of_a_file(folder):
    (folder / "coded_said.py").write_text(NET + "    def __init__(self, prompt=''):\n        self.prompt = prompt\n")
    method = PythonMethod(f"coded_said:Net[prompt={'oyster ' * 50}]")
    assert "file of prompt" not in method.identity["files"]


def test_warnings_of_a_methods_source_are_left_to_its_import(folder):
    (folder / "coded_warns.py").write_text("import coded_utils\nPATTERN = '\\d'\n" + BARE)
    (folder / "coded_utils.py").write_text("")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert set(code_digests("coded_warns:Net")) == {"coded_warns.py", "coded_utils.py"}


def test_what_is_known_is_what_runs_where_another_copy_is_in_the_working_folder(folder, tmp_path_factory, monkeypatch):
    installed = tmp_path_factory.mktemp("installed") / "coded.py"
    installed.write_text(NET + "# installed\n")
    monkeypatch.setenv("PYTHONPATH", str(installed.parent), prepend=os.pathsep)
    monkeypatch.setattr("sys.path", [str(installed.parent), *filter(None, sys.path)])
    command = PythonMethod("coded:Net").command(folder, folder, 0)
    asks = "from oysterbench.methods import find_method; print(find_method('coded:Net').run.__code__.co_filename)"
    done = subprocess.run([*command[: command.index("-m")], "-c", asks], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == str(installed), done.stderr
    assert code_digests("coded:Net") == {"coded.py": file_digest(installed)}
