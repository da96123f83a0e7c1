"""Folders of the machine that results come from, which are cut from what is published: they mean nothing to others, and
may reveal more than their owner wants."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from oysterbench.core.places import home
from oysterbench.results.records import ResultRecord

TOLD = ("method_settings", "hardware", "reasons", "failure", "notes", "info")
"""Fields of a result with texts that come from the machine, the method or its user."""

DIGEST_OF = "sha256 of "
"""How keys of the versions of a run begin that name a file."""

FOLDER = "FOLDER"
"""Stands for a known folder itself, such as the user's, whose name may be that of a person."""

_BEGIN = r"(?:\bfile://|(?<![A-Za-z0-9_.~/])|(?<=\s-[A-Za-z])|(?<=^-[A-Za-z]))"
"""Where a path begins: not within a word or another path, but also after an option, as in -I/usr/include."""

_PART = r"[^/\s=:,'\"]+"
"""A folder in a path that is not in quotes."""

_OUTPUT = r"(?<![\w.~+/-])(?:[\w.~+-]+/)*runs/[^/\s]+/[^/\s]+/[0-9]+/"
"""The folder of a run (`output_place`), also where that of the results was given relative to the working folder."""


def without_folders(result: ResultRecord, here: Collection[str] = (), topics: Collection[str] = ()) -> ResultRecord:
    """Cut the folders of the machine from all texts of a result, keys included; the names of files stay.

    Cut are `here` (`folders_here`), the folders of its program and of its output, and whatever else is an absolute path
    in at least two folders, or one that begins with ~/, ./ or ../. Addresses of the web stay, as do `topics`.
    """
    pattern = _pattern(frozenset([*here, *_of_program(result)]), frozenset(topics))
    return replace(result, **{key: _cut(getattr(result, key), pattern) for key in TOLD})


def folders_here(results: Path) -> set[str]:
    """Folders of this machine by which results may name files: those of the user and of oysterbench, the working and
    the temporary folder, and the folder of the results."""
    folders = (results, Path.home(), home(), Path.cwd(), Path(tempfile.gettempdir()))
    return {form for folder in folders for form in (os.path.abspath(folder), os.path.realpath(folder))}


def _of_program(result: ResultRecord) -> Iterator[str]:
    """Folders of the program that was run, and of the files that its command names."""
    run = result.info.get("run")
    about = run if isinstance(run, Mapping) else {}
    command, versions = about.get("command"), about.get("versions")
    named = [str(command[0])] if isinstance(command, list) and command else []
    if isinstance(versions, Mapping):
        named += [str(key).removeprefix(DIGEST_OF) for key in versions if str(key).startswith(DIGEST_OF)]
        named.append(str(versions.get("program", "")))
    yield from (os.path.dirname(name) for name in named if name.startswith("/"))


@lru_cache
def _pattern(folders: frozenset[str], topics: frozenset[str]) -> re.Pattern[str]:
    """Pattern of an address of the web, which is kept, or of the folders of a path, all but its last part."""
    # The longest first: of a path in several of them the innermost is cut. The root is not known from others.
    known = _any(sorted(folders - {"/"}, key=len, reverse=True))
    forms = (
        r"(?<=(?P<quote>['\"]))/(?:(?:(?!(?P=quote))[^/\n])+/){2,}(?=[^/\n]+?(?P=quote))",
        rf"(?P<whole>{known})(?!/{_PART}|[A-Za-z0-9_-]|\.[A-Za-z0-9_])/?",
        rf"{known}/(?:{_PART}/)*(?={_PART})",
        rf"/(?:{_PART}/){{2,}}(?={_PART})",
        rf"(?:~|\.\.?)/(?:{_PART}/)*(?={_PART})",
    )
    address = r"(?P<address>\b(?!file:)[A-Za-z][A-Za-z0-9+.-]{0,20}://\S*)"
    path = rf"{_BEGIN}(?!{_any(topics)}(?![A-Za-z0-9_]))(?:{'|'.join(forms)})"
    return re.compile(f"{address}|{path}|{_OUTPUT}")


def _any(texts: Collection[str]) -> str:
    """Pattern of any of these texts; without any, one that matches nothing."""
    return f"(?:{'|'.join(map(re.escape, texts))})" if texts else "(?!)"


def _cut(value: Any, pattern: re.Pattern[str]) -> Any:
    """Cut what a pattern matches from all texts in a value."""
    if isinstance(value, str):
        return pattern.sub(_kept, value)
    if isinstance(value, list | tuple):
        return type(value)(_cut(item, pattern) for item in value)
    if not isinstance(value, Mapping):
        return value
    found: dict[Any, Any] = {}
    for key, item in value.items():
        told = name = _cut(key, pattern)
        number = 1
        while name in found:  # files of one name in several folders
            number += 1
            name = f"{told} ({number})"
        found[name] = _cut(item, pattern)
    return found


def _kept(match: re.Match[str]) -> str:
    """What stays of a match: an address; of a known folder that is named itself, that it was one."""
    return match["address"] or (FOLDER if match["whole"] else "")
