"""Adapters for what is run, a Python method or another program by its command line: a command in, predictions out."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from string import Formatter
from typing import Any, TypeVar

from oysterbench.core.errors import MethodError
from oysterbench.core.helpers import module_command
from oysterbench.methods.code import code_digests, file_digest
from oysterbench.methods.command_line import files_named, filled
from oysterbench.methods.finding import find_method, find_variant, versions_of
from oysterbench.methods.interfaces import Interface, Predicted, RunSequence, interface_of
from oysterbench.methods.method import seed_of
from oysterbench.methods.options import LONGEST
from oysterbench.methods.weights import weights_digests, weights_of
from oysterbench.methods.worker import read_predicted
from oysterbench.version import VERSION

PLAIN_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]*")
OF_SHELL = re.compile(r"\|\|?|&&?|;|([0-9]*|&)>>?[^=\s]\S*|([0-9]*|&)>>?|<<?|<\{.*")
"""Words that are nothing to a program, but pipes, redirections and separators to a shell."""
PACKAGES = ("numpy", "scipy", "opencv-python-headless", "gtsam", "torch")
"""Packages whose versions are kept with a result, if they are installed."""


class MethodAdapter(ABC):
    """A method as the runner sees it. name: in tables and as a folder; form: its input form, one of its interface's."""

    name: str
    form: str
    interface: Interface

    @property
    @abstractmethod
    def identity(self) -> dict[str, Any]:
        """What distinguishes it from another method of the same name, as JSON values."""

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the method, for the record."""
        return {}

    @property
    def about(self) -> Mapping[str, Any]:
        """What readers of results should know: the `sensors` it uses, whether it is `online`, `paper`, `code`."""
        return {}

    @property
    def evaluation(self) -> Mapping[str, Any]:
        """Evaluation options of its track, by key, used unless the user gives others."""
        return {}

    @property
    def weights(self) -> dict[str, Path]:
        """Files of the trained weights that it uses, by name."""
        return {}

    @property
    def limit_factor(self) -> float:
        """Factor on a sequence's default time limit, used if the user gives no limit."""
        return 1.0

    @property
    def left_none(self) -> str:
        """What to say of a run that left no predictions."""
        return f"exited normally, but wrote no {self.interface.leaves.removeprefix('a ')} to {{out}}"

    @abstractmethod
    def versions(self) -> dict[str, str]:
        """Return the versions of the method and of what it runs on, by name."""

    @abstractmethod
    def seed(self, number: int) -> int | None:
        """Return the seed of run `number`, from 0; None if the method takes none."""

    def preparation(self, given: Path, folder: Path, number: int) -> list[str] | None:
        """Return a command that is run before that of run `number`, with the same arguments, and not measured: it
        writes what the run reads. None if nothing has to be written."""
        return None

    @abstractmethod
    def command(self, given: Path, folder: Path, number: int) -> list[str]:
        """Return the command of run `number`. given: the input in its form; folder: where the predictions go."""

    def check(self, sequence: RunSequence) -> None:
        """Check before a run that its options fit a sequence. Raises MethodError where they do not."""
        return

    @abstractmethod
    def take(self, sequence: RunSequence, given: Path, folder: Path) -> Predicted:
        """Read what it left in its folder. Raises MethodError, in one line, where that is not predictions."""

    def own_failure(self, folder: Path) -> str | None:
        """Return the method's own reason for its failure, None if it gave none."""
        return None


class PythonMethod(MethodAdapter):
    """A method given by an entry point's name or as `module:Class`, with or without options, run by `worker`.

    The worker receives a copy without the ground truth: no attribute, however private, leads to it. A class is
    identified by the digests of its code (`code`), an entry point by the version of its package.
    """

    def __init__(self, reference: str, tracks: Sequence[str] = ("slam",)) -> None:
        """Raises MethodError where the method cannot be found, or is of none of these tracks."""
        method, self._options = find_variant(reference)
        if method.track not in tracks:
            raise MethodError(
                f"method {reference!r} is of the track {method.track!r}; expected a method of {tracks[0]!r}"
            )
        self.reference, self.track = reference, method.track
        check_name(method.name.partition("[")[0])
        self.name = method.name
        self.interface = interface_of(method.track)
        self.form = self.interface.own_form
        self._first_seed = seed_of(method)
        self._about = dict(getattr(method, "about", {}))
        described = getattr(method, "as_dict", None)
        self._described = dict(described()) if described is not None else {}
        self._weighs = bool(weights_of(method))

    @property
    def about(self) -> Mapping[str, Any]:
        return self._about

    @property
    def weights(self) -> dict[str, Path]:
        # Asked for again each time: on another machine the files are elsewhere.
        return weights_of(find_method(self.reference)) if self._weighs else {}

    @property
    def identity(self) -> dict[str, Any]:
        weights = self.weights
        named = {key: Path(value) for key, value in self._options.items() if isinstance(value, str) and value}
        files = code_digests(self.reference)
        files |= {f"weights of {name}": digest for name, digest in weights_digests(weights).items()}
        files |= {f"file of {key}": file_digest(path) for key, path in named.items() if _is_further(path, weights)}
        known = {"method": self.reference, "versions": versions_of(self.reference)}
        return {**known, "files": files} if files else known

    @property
    def settings(self) -> dict[str, Any]:
        needed = self.weights
        places = {str(path) for path in needed.values()}
        # Weights are recorded by their digests, not by where they are stored.
        options = {key: value for key, value in self._options.items() if str(value) not in places}
        return {**(self._described or options), **({"weights": weights_digests(needed)} if needed else {})}

    def versions(self) -> dict[str, str]:
        found = {"python": sys.version.split()[0], "oysterbench": VERSION, **versions_of(self.reference)}
        for package in PACKAGES:
            try:
                found[package] = version(package)
            except PackageNotFoundError:
                continue
        return found

    def seed(self, number: int) -> int | None:
        return None if self._first_seed is None else self._first_seed + number

    def command(self, given: Path, folder: Path, number: int) -> list[str]:
        seed = self.seed(number)
        asked = [self.reference, str(given), str(folder), *([] if seed is None else [str(seed)])]
        return module_command("oysterbench.methods.worker", *asked)

    def take(self, sequence: RunSequence, given: Path, folder: Path) -> Predicted:
        try:
            found = read_predicted(folder)
        except FileNotFoundError:
            raise MethodError(
                f"ended before it gave {self.interface.leaves} (exit status 0): it called sys.exit() or os._exit()"
            ) from None
        except (OSError, ValueError, TypeError) as error:
            raise MethodError(f"wrote no predictions: {error}") from None
        if isinstance(found, str):
            raise MethodError(found)
        return found

    def own_failure(self, folder: Path) -> str | None:
        try:
            found = read_predicted(folder)
        except (OSError, ValueError, TypeError):
            return None
        return found if isinstance(found, str) else None


class ExternalCommand(MethodAdapter):
    """Another program. Its command line has {out}, where it leaves its predictions, and one form of its interface.

    It is identified not by its name alone but by the digests of the program and of the files that its command line
    names, also in the commands of a shell (`sh -c`), where the values of placeholders are quoted for that shell.
    options: of the interface; `poses_of` (SLAM): frame whose poses it writes: base, imu, camera or a camera's name
    """

    def __init__(self, template: str, name: str = "", track: str = "slam", poses_of: str = "") -> None:
        """Raises MethodError where the command line does not have that form, or its program does not exist."""
        self.template, self.interface = template, interface_of(track)
        forms = self.interface.forms
        try:
            self._words = shlex.split(template)
            asked = {key for word in self._words for _, key, _, _ in Formatter().parse(word) if key is not None}
        except ValueError as error:
            raise MethodError(f"--command {template!r}: {error}; write {{{{ and }}}} for literal braces") from None
        if sign := next((word for word in self._words if OF_SHELL.fullmatch(word)), None):
            raise MethodError(
                f"--command {template!r}: {sign!r} is for a shell, and the program would get it as a word: start a "
                "shell with sh -c '...', or give the program {out} itself"
            )
        known = [*forms, "out", *self.interface.further, "seed"]
        for key in sorted(asked - set(known)):
            raise MethodError(
                f"--command {template!r}: unknown placeholder {{{key}}}; known: "
                f"{', '.join(f'{{{k}}}' for k in known)}; write {{{{ and }}}} for literal braces"
            )
        found = sorted(asked & set(forms))
        if "out" not in asked or len(found) != 1:
            raise MethodError(
                f"--command {template!r}: expected {{out}}, where the program writes {self.interface.leaves}, and one "
                f"of {', '.join(f'{{{form}}}' for form in forms)}, which it reads, got "
                f"{', '.join(f'{{{key}}}' for key in sorted(asked)) or 'no placeholder'}"
            )
        try:
            filled(self._words, dict.fromkeys(known, ""))
        except ValueError as error:
            raise MethodError(f"--command {template!r}: {error}") from None
        program = shutil.which(self._words[0])
        if program is None:
            raise MethodError(f"--command {template!r}: no program {self._words[0]!r} that can be executed")
        self.program = Path(program).absolute()  # symlinks are not resolved: what a program does may depend on its name
        self.name = check_name(name or Path(self._words[0]).stem)
        self.form = found[0]
        self.options = self.interface.options_of(self.form, poses_of)
        self._takes_seed = "seed" in asked

    @property
    def identity(self) -> dict[str, Any]:
        return {**self.settings, "files": self._digests()}

    @property
    def settings(self) -> dict[str, Any]:
        return {"command": self.template, **self.options}

    def _digests(self) -> dict[str, str]:
        """SHA-256 of the program, and of what else the command line names (`files_named`)."""
        files = {str(path): path for path in {*files_named(self._words), self.program}}
        return {name: file_digest(files[name]) for name in sorted(files)}

    def versions(self) -> dict[str, str]:
        files = {f"sha256 of {name}": digest for name, digest in self._digests().items()}
        return {"oysterbench": VERSION, "program": str(self.program), **files}

    def seed(self, number: int) -> int | None:
        return number if self._takes_seed else None

    def command(self, given: Path, folder: Path, number: int) -> list[str]:
        left = {key: str(folder / name) for key, name in {"out": self.interface.out, **self.interface.further}.items()}
        values = {self.form: str(given), **left, "seed": str(number)}
        return [str(self.program), *filled(self._words, values)[1:]]

    def check(self, sequence: RunSequence) -> None:
        self.interface.check(sequence, self.form, self.options)

    def take(self, sequence: RunSequence, given: Path, folder: Path) -> Predicted:
        if not (folder / self.interface.out).exists():
            raise MethodError(self.left_none)
        return self.interface.take(sequence, given, folder, self.form, self.options)


AnyAdapter = TypeVar("AnyAdapter", bound=MethodAdapter)


def check_distinct(adapters: Mapping[str, AnyAdapter]) -> list[AnyAdapter]:
    """Adapters from those by their references. Raises MethodError where two have one name: they would pass for two runs
    of one method."""
    references: dict[str, str] = {}
    for reference, adapter in adapters.items():
        if (other := references.setdefault(adapter.name, reference)) != reference:
            raise MethodError(
                f"{other} and {reference} are both named {adapter.name!r}: give each a `name` of its own, or run one "
                "at a time, each with --out of its own"
            )
    return list(adapters.values())


def _is_further(path: Path, weights: Mapping[str, Path]) -> bool:
    return os.path.isfile(path) and path not in weights.values()


def check_name(name: str) -> str:
    """Return a method's name, if a folder and a record of a board can have it. Raises MethodError if not."""
    if not PLAIN_NAME.fullmatch(name):
        raise MethodError(f"name of a method: expected letters, digits and . _ + -, got {name!r}")
    if len(name) > LONGEST:
        raise MethodError(f"name of a method: expected at most {LONGEST} characters, got {len(name)}: {name!r}")
    return name
