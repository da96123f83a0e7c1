"""Salt of hidden splits: a secret that goes into every random stream. It is read and used, but never shown."""

from __future__ import annotations

import os
from pathlib import Path

from oysterbench.core.errors import RecipeError

SALT_FILE, SALT = "OYSTERBENCH_SALT_FILE", "OYSTERBENCH_SALT"
"""Environment variables: the path of a file that holds the salt, and the salt itself."""

LEAST_BYTES = 16
LEAST_DISTINCT = 8  # different byte values: with fewer it was typed, not drawn at random
HOW_TO_MAKE = "`head -c 32 /dev/urandom | base64 > FILE` makes a good one"


def how_to_take_part(name: str) -> str:
    """What participants type to get a hidden split; a salt of their own would give them other data than the board's."""
    return f"to take part: `oysterbench download {name} --from URL --key KEY`, from the hub of the board that scores it"


class Salt(bytes):
    """Bytes that never show in a message, log or traceback."""

    def __repr__(self) -> str:
        return "Salt(...)"

    __str__ = __repr__


def read_salt(file: Path | None = None) -> Salt | None:
    """Read the salt from a file, or from the environment; None where none is given. Trailing newlines are dropped.

    Raises RecipeError for a file that cannot be read, and for a salt that could be guessed: what is made with it is
    published, so guesses can be checked against it.
    """
    where, found = "--salt-file", file
    if found is None and os.environ.get(SALT_FILE):
        where, found = SALT_FILE, Path(os.environ[SALT_FILE])
    if found is not None:
        try:
            data = found.read_bytes()
        except OSError as error:
            raise RecipeError(
                f"{where}: {found}: the salt cannot be read: {error.strerror}; for a new split, {HOW_TO_MAKE}"
            ) from None
    elif os.environ.get(SALT):
        where, data = SALT, os.environb[SALT.encode()]
    else:
        return None
    salt = Salt(data.rstrip(b"\r\n"))
    if not is_strong(salt):
        raise RecipeError(
            f"{where}: expected a salt of at least {LEAST_BYTES} bytes, {LEAST_DISTINCT} of them different, so that it "
            f"cannot be guessed; got {len(salt)} bytes, {len(set(salt))} different; {HOW_TO_MAKE}"
        )
    return salt


def is_strong(salt: bytes) -> bool:
    """Whether a salt is long and varied enough to keep a split hidden."""
    return len(salt) >= LEAST_BYTES and len(set(salt)) >= LEAST_DISTINCT


def salt_for(name: str, hidden: bool, file: Path | None = None) -> bytes:
    """Salt that the split of this name is made with: empty if it is public, whatever the environment holds.

    Raises RecipeError where a hidden split has none, and where one is given for a public split.
    """
    if not hidden:
        if file is not None:
            raise RecipeError(
                f"--salt-file: split {name} is public, and the same for everybody; only hidden splits take a salt"
            )
        return b""
    salt = read_salt(file)
    if salt is None:
        raise RecipeError(
            f"split {name} is hidden: it needs a secret salt, and none is given; {how_to_take_part(name)}; to host it: "
            f"--salt-file, or {SALT_FILE} or {SALT} in the environment; {HOW_TO_MAKE}"
        )
    return salt
