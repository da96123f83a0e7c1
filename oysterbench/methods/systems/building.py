"""Obtains the source of a published system at its commit, makes the edits that it needs, and builds it.

Each build has its own folder under the home: `source/`, `build/`, `build.log` and, once complete, `built.json`.
"""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import tomllib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import IO

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import MethodError
from oysterbench.core.locks import locked
from oysterbench.methods.processes import tail
from oysterbench.methods.systems.manifest import Submodule, System
from oysterbench.version import VERSION

BUILT, LOG, EDITS = "built.json", "build.log", "edits.toml"
RENDERER = "warp"
"""Module without which nothing can be rendered; the extra `render` installs it."""
STEP = re.compile(r"^\[(\d+)/(\d+)\]|^\[ *(\d+)%\]")
"""Start of the progress lines of Ninja and Make."""

Announce = Callable[[str], None]


@dataclass(frozen=True)
class Build:
    """A finished build of a system. compiler: first line of its version output; cpu_s: CPU time that the build took;
    size_bytes: total size of its files; built_by: version of oysterbench, for readers of its built.json"""

    commit: str
    recipe: str
    compiler: str
    cpu_s: float
    size_bytes: int
    built_by: str


def built(system: System) -> Build | None:
    """Return the build that is here; None if there is none, or only of another commit or recipe.

    Raises MethodError where built.json is not what this version writes.
    """
    try:
        return Build(**json.loads((system.place / BUILT).read_text(encoding="utf-8")))
    except FileNotFoundError:
        return None
    except (ValueError, TypeError) as error:
        raise MethodError(f"{system.place / BUILT}: not what this version writes ({error}); build it again") from None


def environment(system: System) -> Path:
    """Path of the virtual environment with a system's Python requirements."""
    return system.place / "venv"


def interpreter(system: System) -> Path:
    """Path of the Python interpreter with a system's requirements. Raises MethodError where the system is not built."""
    find_build(system)
    return environment(system) / "bin" / "python"


def find_build(system: System) -> Build:
    """Return the build that is here. Raises MethodError, with what to type, where there is none."""
    found = built(system)
    if found is None:
        raise MethodError(f"{system.name} is not built here; type: oysterbench systems build {system.name}")
    return found


def build(
    system: System,
    sources: Sequence[Path] = (),
    jobs: int | None = None,
    again: bool = False,
    announce: Announce = print,
) -> Build:
    """Build a system unless it is built already; an interrupted build starts again from scratch.

    sources: clones, bare or not: each repository is taken from the first that has its commit, or from the network if no
    clones are given; jobs: parallel compilers; again: rebuild it in any case
    Raises MethodError with what is missing, or with the last output of the step that failed and the path of the log.
    """
    system.place.mkdir(parents=True, exist_ok=True)
    with locked(system.place.with_suffix(".lock")):
        known = built(system)
        if known is not None and not again:
            return known
        _check_packages(system)
        (system.place / BUILT).unlink(missing_ok=True)
        before = _cpu_s()
        with open(system.place / LOG, "wb") as log:
            if system.description.python:
                _install(system, log, announce)
            if system.description.source:
                _obtain(system, sources, log, announce)
            if (system.folder / "CMakeLists.txt").exists():
                _compile(system, jobs, log, announce)
        prepare = getattr(import_module(f"{system.module}.configure"), "prepare", None)
        if prepare is not None:
            prepare(system.place, announce)
        found = Build(
            commit=system.description.commit,
            recipe=system.digest,
            compiler=_compiler(),
            cpu_s=round(_cpu_s() - before, 1),
            size_bytes=sum(path.lstat().st_size for path in system.place.rglob("*") if path.is_file()),
            built_by=VERSION,
        )
        write_atomically(system.place / BUILT, json.dumps(asdict(found), indent=1).encode())
        return found


def missing_packages(packages: Sequence[str]) -> list[str]:
    """Debian packages that are not installed; empty where there is no `dpkg-query` to ask."""
    if shutil.which("dpkg-query") is None:
        return []
    asked = ["dpkg-query", "--show", "--showformat", "${Package} ${db:Status-Status}\n", *packages]
    answer = subprocess.run(asked, capture_output=True, text=True, check=False).stdout if packages else ""
    here = {line.split()[0] for line in answer.splitlines() if line.endswith(" installed")}
    return [name for name in packages if name not in here]


def _check_packages(system: System) -> None:
    if missing := missing_packages(system.description.packages):
        raise MethodError(
            f"{system.name} needs packages that are not installed; type: sudo apt-get install {' '.join(missing)}"
        )
    if system.description.source and shutil.which("git") is None:
        raise MethodError(f"{system.name} needs git to obtain its source; type: sudo apt-get install git")
    if system.description.renders and find_spec(RENDERER) is None:
        raise MethodError(
            f"{system.name} renders sequences once it is compiled, and needs the renderer, which is not installed; "
            "type: pip install 'oysterbench[render]'"
        )


def _obtain(system: System, given: Sequence[Path], log: IO[bytes], announce: Announce) -> None:
    """Obtain the needed folders of the source and its submodules at their commits, and make the edits."""
    described = system.description
    whole = Submodule(source=described.source, commit=described.commit, folders=described.folders)
    with tempfile.TemporaryDirectory(dir=system.place) as scratch:
        tree = Path(scratch) / "source"
        for number, (place, needed) in enumerate([("", whole), *described.submodules.items()]):
            clone = _clone(system, needed, given, Path(scratch) / f"clone-{number}", log, announce)
            archive = Path(scratch) / "source.tar"
            words = ["git", "-C", str(clone), "archive", "--output", str(archive), needed.commit]
            _call(system, [*words, *needed.folders], log)
            (tree / place).mkdir(parents=True, exist_ok=True)
            # tarfile's filters came with Python 3.11.4, and Debian 12 has 3.11.2.
            _call(system, ["tar", "--extract", "--file", str(archive), "--directory", str(tree / place)], log)
        make_edits(system.folder / EDITS, tree)
        shutil.rmtree(system.place / "source", ignore_errors=True)
        os.replace(tree, system.place / "source")


def _clone(
    system: System, needed: Submodule, given: Sequence[Path], folder: Path, log: IO[bytes], announce: Announce
) -> Path:
    """Return a clone with the commit: the first given one that has it, or, if none is given, one from the network."""
    for path in given:
        asked = ["git", "-C", str(path), "cat-file", "-e", f"{needed.commit}^{{commit}}"]
        if subprocess.run(asked, stdout=log, stderr=log, check=False).returncode == 0:
            announce(f"taking {needed.commit[:8]} from {path}")
            return path.absolute()
    if given:
        raise MethodError(
            f"{system.name} needs {needed.source} at {needed.commit}, which is in none of "
            f"{', '.join(map(str, given))}; give a clone of it with another --source"
        )
    announce(f"fetching {needed.source} at {needed.commit[:8]}")
    _call(system, ["git", "init", "--quiet", "--bare", str(folder)], log)
    _call(system, ["git", "-C", str(folder), "fetch", "--quiet", "--depth", "1", needed.source, needed.commit], log)
    return folder


def make_edits(edits: Path, tree: Path) -> None:
    """Replace texts in a source tree, wherever they occur in their file. Raises MethodError where one is absent."""
    if not edits.exists():
        return
    for edit in tomllib.loads(edits.read_text(encoding="utf-8"))["edit"]:
        path = tree / edit["file"]
        text = path.read_text(encoding="utf-8", errors="surrogateescape")
        if edit["find"] not in text:
            raise MethodError(f"{edits}: {edit['file']} of the source has no text {edit['find']!r} to replace")
        changed = text.replace(edit["find"], edit["replace"])
        path.write_text(changed, encoding="utf-8", errors="surrogateescape")


def _compile(system: System, jobs: int | None, log: IO[bytes], announce: Announce) -> None:
    folder = system.place / "build"
    shutil.rmtree(folder, ignore_errors=True)
    ninja = ["-G", "Ninja"] if shutil.which("ninja") else []
    configure = ["cmake", *ninja, "-S", str(system.folder), "-B", str(folder), "-DCMAKE_BUILD_TYPE=Release"]
    announce(f"configuring {system.name}")
    _call(system, [*configure, f"-DUPSTREAM={system.place / 'source'}"], log)
    count = jobs or len(os.sched_getaffinity(0))
    _call(system, ["cmake", "--build", str(folder), "--parallel", str(count)], log, announce)
    if not (folder / system.description.program).exists():
        raise MethodError(f"{system.name}: its build produced no {system.description.program}; {system.place / LOG}")


def _install(system: System, log: IO[bytes], announce: Announce) -> None:
    """Install the Python requirements, in addition to the packages of this interpreter."""
    place = environment(system)
    announce(f"installing {', '.join(system.description.python)}")
    _call(system, [sys.executable, "-m", "venv", "--clear", "--system-site-packages", str(place)], log)
    # If this interpreter is itself in a virtual environment, its packages are not among the system's.
    own = sysconfig.get_path("purelib")
    theirs = Path(sysconfig.get_path("purelib", "venv", {"base": str(place), "platbase": str(place)}))
    (theirs / "beside.pth").write_text(f"import site; site.addsitedir({own!r})\n", encoding="utf-8")
    _call(system, [str(place / "bin" / "pip"), "install", "--no-input", *system.description.python], log)


def _call(system: System, command: Sequence[str], log: IO[bytes], announce: Announce | None = None) -> None:
    """Run a build step; its output goes to the log, and its progress to `announce`. When this is interrupted, the step
    is ended with all that it has started."""
    log.write(f"$ {' '.join(command)}\n".encode())
    log.flush()
    try:
        with subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        ) as step:
            assert step.stdout is not None
            try:
                for line in step.stdout:
                    log.write(line.encode())
                    if announce is not None and (where := STEP.match(line)):
                        announce(f"building {system.name}: {where.group().strip('[] ')}")
            except BaseException:  # Ctrl-C and SIGTERM included; leaving this block waits for the step
                with suppress(ProcessLookupError):
                    os.killpg(step.pid, signal.SIGTERM)
                raise
    except FileNotFoundError:
        raise MethodError(f"{system.name} needs {command[0]}, which is not installed") from None
    log.flush()
    if step.returncode:
        raise MethodError(
            f"{system.name}: {command[0]} exited with status {step.returncode}; last output: {tail(Path(log.name))}; "
            f"full log: {log.name}"
        )


def _compiler() -> str:
    try:
        said = subprocess.run(["c++", "--version"], capture_output=True, text=True, check=False).stdout
    except FileNotFoundError:
        return ""
    return said.partition("\n")[0]


def _cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
