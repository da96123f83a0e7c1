"""Command lines of external programs: the shells in them, the values of their placeholders, and the files they name."""

from __future__ import annotations

import os
import re
import shlex
import shutil
from collections.abc import Iterator, Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from string import Formatter

SHELLS = ("sh", "bash", "dash", "ash", "ksh", "zsh")
"""Shells whose commands, after -c, are understood."""

STARTERS = ("env", "exec", "ionice", "nice", "nohup", "numactl", "setsid", "stdbuf", "taskset", "time", "timeout")
"""Programs that start the one named after them."""

ASSIGNED = re.compile(r"[A-Za-z_]\w*=")
PYTHON = re.compile(r"python[0-9.]*|pypy[0-9.]*")
SIGNS = "();<>|&`\n"
"""Characters that end a word of a shell's commands, besides blanks."""
ENDS = "();&|\n"
"""Those of them that end a command."""
BEFORE = ("!", "{", "builtin", "command", "do", "elif", "else", "if", "then", "time", "until", "while")
"""Words of a shell that come before a command."""


def scripts_in(words: Sequence[str]) -> set[int]:
    """Indices of the words that a shell on a command line runs as commands.

    >>> scripts_in(["env", "A=1", "bash", "-eo", "pipefail", "-c", "exit 3", "bash", "{out}"])
    {6}
    """
    found = set()
    for i, word in enumerate(words):
        if Path(word).name not in SHELLS:
            continue
        runs, valued = False, False
        for j in range(i + 1, len(words)):
            option = words[j]
            if valued:
                valued = False
            elif option[:1] not in ("-", "+"):
                if runs:
                    found.add(j)
                break
            else:
                short = option[:2] != "--"
                runs = runs or (short and "c" in option)
                valued = option[-1] in "oO" if short else option in ("--rcfile", "--init-file")
    return found


def filled(words: Sequence[str], values: Mapping[str, str]) -> list[str]:
    """Put in the values of placeholders, in a shell's commands quoted for that shell. Raises ValueError where that is
    impossible.

    >>> filled(["sh", "-c", 'cd "$(dirname {out})" && my_slam "{out}"', "{out}"], {"out": "/a b/$c"})
    ['sh', '-c', 'cd "$(dirname \\'/a b/$c\\')" && my_slam "/a b/\\\\$c"', '/a b/$c']
    """
    scripts = scripts_in(words)
    return [_filled_script(w, values) if i in scripts else w.format(**values) for i, w in enumerate(words)]


def _filled_script(script: str, values: Mapping[str, str]) -> str:
    quotes, found = Quotes(), ""
    for literal, name, form, conversion in Formatter().parse(script):
        quotes.read(literal)
        found += literal
        if name is not None:
            field = f"{{{name}{f'!{conversion}' if conversion else ''}{f':{form}' if form else ''}}}"
            found += quotes.quoted(field, field.format(**values))
    return found


UNSAFE = {
    "`": "in backquotes: write $(...)",
    "#": "in a comment",
    "<<": "in a here-document or after one",
    "$'": "in $'...'",
    "${": 'in "${...}"',
    "case": "after case in a quoted $(...)",
    "eval": "in a command of eval",
}
"""Places in a shell's commands at which no value is put in."""

COMMANDS = ("", "(")
"""What is open where commands are read: nothing, or "(" and "$("."""
HERE = "\0"
"""The place up to which commands are read, in their words."""


class Quotes:
    """The quotes that are open at a place of a shell's commands, which are read from left to right."""

    def __init__(self) -> None:
        # "" and "(": none; quotes; "`"; "((" of arithmetic; "${" within quotes; "#" and "<<" of comments and
        # here-documents; "case" in "$(...)": which of its ")" end a pattern, and which the "$(", is not followed
        self._open = [""]
        self._begins = [(0, 0)]  # where in the text each of these, and the latest command in it, begins
        self._text, self._last = "", "\n"

    def read(self, text: str) -> None:
        """Read on."""
        i = 0
        while i < len(text):
            inside, here, depth = self._open[-1], len(self._text), len(self._open)
            ends = inside in COMMANDS and text[i] in ENDS
            if ends and not {*self._open} <= {*COMMANDS} and _first(next(self._commands())) == "case":
                self._open.append("case")
            n = self._step(text[i], text[i : i + 3])
            self._text += text[i : i + n]
            self._last = text[i + n - 1 : i + n]
            i += n
            if len(self._open) > depth:
                self._begins.append((here, len(self._text)))
            elif len(self._open) < depth:
                begin, _ = self._begins.pop()
                if inside in ("(", "(("):
                    self._text = f"{self._text[:begin]}x"  # a part of the word that it is in
            elif ends:
                self._begins[-1] = (self._begins[-1][0], len(self._text))

    def _commands(self) -> Iterator[list[str]]:
        """Words of the commands around this place as far as they are read, from the innermost out. HERE is part of the
        last word, unless that is the target of `>`."""
        end, quotes = len(self._text), ""
        for inside, (begin, command) in zip(reversed(self._open), reversed(self._begins), strict=True):
            if inside in COMMANDS:
                yield [[], *_parsed(f"{self._text[command:end]}{HERE}{quotes}")][-1]
                end, quotes = begin, ""
            elif inside in ("'", '"'):
                quotes += inside

    def _step(self, one: str, ahead: str) -> int:
        """Read a character, or more that belong together. Returns how many."""
        inside = self._open[-1]
        plain = inside in COMMANDS
        if inside in ("<<", "case"):
            return 1
        if inside == "#":
            if one != "\n":
                return 1
            self._open.pop()
            return 0  # the end of a line ends the command before the comment, too
        if inside in ("'", "$'") and one == "'":
            self._open.pop()
        elif inside == "'":
            return 1
        elif one == "\\":
            return 2  # at the end of the text one more than there is, so that `_last` is empty
        elif (one == inside and one in '"`') or f"{inside}{one}" in ("()", "${}"):
            self._open.pop()
        elif inside in ("`", "$'"):
            return 1
        elif inside == "((" and one == ")":
            self._open[-1:] = [] if ahead.startswith("))") else ["("]  # the latter were commands in two brackets
            return 2 if ahead.startswith("))") else 1
        elif ahead == "$((" or (plain and ahead.startswith("((")):
            self._open.append("((")
            return 3 if one == "$" else 2
        elif inside in ('"', "${") and ahead.startswith("${"):
            self._open.append("${")
            return 2
        elif ahead.startswith("$(") or (plain and ahead.startswith("$'")):
            self._open.append("(" if ahead[1] == "(" else "$'")
            return 2
        elif one in '"`' or ((plain or inside == "((") and one in "'("):
            self._open.append(one)
        elif plain and one == "#" and (self._last.isspace() or self._last in tuple(SIGNS)):
            self._open.append("#")
        elif plain and ahead.startswith("<<"):
            if ahead == "<<<":  # a word
                return 3
            self._open.append("<<")
        return 1

    def quoted(self, field: str, value: str) -> str:
        """Return a value as it is written here. Raises ValueError where no way to write it is safe."""
        inside = within = self._open[-1]
        if "${" in takewhile(lambda each: each not in COMMANDS, reversed(self._open)):
            within = "${"
        for command in self._commands():
            if any(HERE in command[i] for i in scripts_in(command)):
                raise ValueError(
                    f"{field} is in a shell within a shell: write sh -c '... \"$1\"' sh {field} in the outer one"
                )
            if _first(command) == "eval" and any(HERE in word for word in command):
                within = "eval"
        if not self._last or within in UNSAFE:
            raise ValueError(
                f"{field} is {UNSAFE.get(within, 'after a backslash')}, where blanks and quotes in its value would do "
                f"harm: write sh -c '... \"$1\"' sh {field}"
            )
        self._text += "x"
        self._last = "x"
        if inside == "'":
            return value.replace("'", "'\"'\"'")
        if inside == '"':
            return re.sub(r'(["\\$`])', r"\\\1", value)
        return shlex.quote(value)


def _first(command: Sequence[str]) -> str:
    """The first word of a simple command, also in the body of a function: its program, or a word such as eval."""
    words = list(command)
    if "{" in words:
        words = words[words.index("{") + 1 :]
    return next((word for word in words if word not in BEFORE and not ASSIGNED.match(word)), "")


def files_named(words: Sequence[str]) -> set[Path]:
    """Files that exist and that a command line names, also in the commands of shells: programs, by PATH too, scripts,
    other files (also as `--config=FILE`), and modules of `python -m`; a package is named by its folder."""
    folders = [Path()]
    found: set[Path] = set()
    for depth, command in _commands([word.replace("{{", "{").replace("}}", "}") for word in words]):
        if depth:  # a shell expands them
            command = [_expanded(word) for word in command]
        if command[:1] == ["cd"] and len(command) > 1:
            places = (Path(os.path.normpath(each / command[1])) for each in folders)
            folders = list(dict.fromkeys([*folders, *(place for place in places if os.path.isdir(place))]))
        named = command if depth else command[1:]  # the first word is looked for in PATH only
        parts = {part for word in named for part in (word, word.partition("=")[2]) if part}
        if depth:  # such as --config=~/rig.yaml
            parts = {_expanded(part) for part in parts}
        paths = {folder / part for folder in folders for part in parts}
        found |= {path for path in paths if os.path.isfile(path)}
        found |= set(_programs(command)) | set(_modules(command, folders))
    return found


def _expanded(word: str) -> str:
    return os.path.expandvars(os.path.expanduser(word))


def _commands(words: list[str], depth: int = 0) -> Iterator[tuple[int, list[str]]]:
    """A command, then those that shells in it run; depth: of shells."""
    yield depth, words
    scripts = scripts_in(words)
    for i, word in enumerate(words):
        if i in scripts or (depth and re.search(rf"[\s{re.escape(SIGNS)}]", word)):  # such as "$(cat names)"
            for command in _parsed(word):
                yield from _commands(command, depth + 1)


def _parsed(script: str) -> list[list[str]]:
    """Simple commands of a shell's commands, without their quotes and the targets of `>`, which are written."""
    lexer = shlex.shlex(script, posix=True, punctuation_chars=SIGNS)
    lexer.whitespace, lexer.whitespace_split, lexer.commenters = " \t\r", True, ""
    try:
        tokens = list(lexer)
    except ValueError:  # quotes that are not closed, such as an apostrophe in a comment
        tokens = re.findall(rf"[{re.escape(SIGNS)}]+|[^\s'\"{re.escape(SIGNS)}]+", script)
    found: list[list[str]] = [[]]
    target = False
    for token in tokens:
        if set(token) <= set(SIGNS):
            target = ">" in token
            if not target:
                found.append([])
        elif not target:
            found[-1].append(token)
        else:
            target = False
    return [command for command in found if command]


def _programs(command: Sequence[str]) -> Iterator[Path]:
    """The program in PATH that a command starts: its first word that is one; after a starter, also the next."""
    for word in command:
        program = shutil.which(word)
        if program is not None:
            if os.sep not in word:
                yield Path(program).absolute()
            if Path(word).name not in STARTERS:
                return


def _modules(command: Sequence[str], folders: Sequence[Path]) -> Iterator[Path]:
    """Module, or package as a folder, that `python -m` runs, if it is in the working folder or one of PYTHONPATH."""
    given = [word.partition("=")[2] for word in command if word.startswith("PYTHONPATH=")]
    given.append(os.environ.get("PYTHONPATH", ""))
    paths = [Path(each) for text in given for each in text.split(os.pathsep) if each]
    for name in _modules_run(command):
        for folder in dict.fromkeys([*folders, *paths]):
            if os.path.isfile(folder / f"{name}.py"):
                yield folder / f"{name}.py"
            elif name.isidentifier() and os.path.isdir(folder / name):
                yield folder / name


def _modules_run(command: Sequence[str]) -> Iterator[str]:
    """Names of modules, or of their packages, that `python -m` runs; -m after a script is an option of that."""
    for i, word in enumerate(command):
        if not PYTHON.fullmatch(Path(word).name):
            continue
        options = iter(command[i + 1 :])
        for option in options:
            if option in ("-W", "-X"):
                next(options, None)
            elif option.startswith("-") and option.endswith("m"):  # also -um
                yield next(options, "").partition(".")[0]
                break
            elif not option.startswith("-") or option.endswith("c"):
                break
