"""Untrusted text: JSON, what may be printed as it is, and what makes one name look like another."""

from __future__ import annotations

import json
import re
import unicodedata
from typing import Any
from urllib.parse import urlsplit

IGNORABLE = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0\U000e0100-\U000e01ef]"
)
"""Characters drawn as nothing, although their category does not say so (Default_Ignorable_Code_Point of Unicode, and
the Braille blank)."""

LIKE_LATIN = re.compile("[ΑΒΕΖΗΙΚΜΝΟΡΤΥΧινορυ\u03f2\u03f3\u03f9\u0400-\u052f\u0530-\u058f\u13a0-\u13fd]")
"""Greek letters that look like Latin ones, and all of Cyrillic, Armenian and Cherokee. Other Greek letters occur next
to Latin ones in formulas."""

LATIN = re.compile("[A-Za-z]")


def read_json(data: bytes | str) -> Any:
    """Parse a JSON document in UTF-8. Raises ValueError for anything wrong with it, including nesting too deep for the
    parser, a number with too many digits, and text that is not valid Unicode and so could not be written again."""
    text = data if isinstance(data, str) else data.decode("utf-8-sig")
    try:
        value = json.loads(text)
        if "\\ud" in text or "\\uD" in text:  # surrogates, which may be unpaired
            json.dumps(value, ensure_ascii=False).encode()
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except ValueError as error:
        if "integer string conversion" in str(error):  # the message goes on with advice to whoever runs Python
            raise ValueError("it has a number of too many digits") from None
        raise
    return value


def separator(table: str) -> str:
    """Separator of a CSV table: a semicolon if the first line has one, as spreadsheets write it where the comma is the
    decimal sign; else a comma, or a tab if that line has tabs alone, as what is copied from a spreadsheet."""
    first = table.partition("\n")[0]
    return ";" if ";" in first else "\t" if "\t" in first and "," not in first else ","


def printable(text: str) -> str:
    r"""Escape, as JSON does, everything in a text that a terminal may obey or that nobody sees.

    Text that is JSON thus stays JSON with the same values; line ends and tabs stay.

    >>> printable("a\x1b[2Jb")
    'a\\u001b[2Jb'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in "\n\t" else json.dumps(c)[1:-1] for c in text)


def as_unicode(text: str) -> str:
    r"""Replace what a file in UTF-8 cannot hold, bytes of file names that are not UTF-8, by question marks.

    >>> as_unicode("l\udce4t/\u00fc") == "l?t/\u00fc"
    True
    """
    return text.encode(errors="replace").decode()


def in_one_line(error: Exception, most: int = 200) -> str:
    """Message of an error, probably from another library, in one line: its type if it has none, and without addresses
    of objects, which differ each time and reveal the memory layout.

    >>> in_one_line(ValueError("malformed:\\n  <ast.Name object at 0x7f3922>"))
    'malformed: <ast.Name object>'
    """
    text = re.sub(r" at 0x[0-9a-fA-F]+", "", " ".join(str(error).split()))
    return text[:most] or type(error).__name__


def web_host(text: str) -> str:
    """Host of a web address, with its port; empty where the text is no web address that can be opened.

    >>> web_host("https://example.org:8080/x"), web_host("http://[x"), web_host("ftp://example.org")
    ('example.org:8080', '', '')
    >>> web_host("http://"), web_host("https://a b"), web_host("https://:80"), web_host("https://a:x")
    ('', '', '', '')
    """
    try:
        parts = urlsplit(text)
        named = parts.hostname and (parts.port is None or parts.port > 0)
    except ValueError:  # such as brackets without an IPv6 address in them, or a port that is no number
        return ""
    known = parts.scheme in ("http", "https") and named and not re.search(r"[\s<>\"\\^`{|}]", parts.netloc)
    return parts.netloc if known else ""


def unseen(text: str) -> str | None:
    """First character without a visible glyph: a control, format or unassigned character, or a space other than the
    ordinary one. None where there is none."""
    return next((c for c in text if not c.isprintable() or IGNORABLE.match(c)), None)


def mixed_word(text: str) -> str | None:
    """First word that mixes Latin letters with letters that look like them. None where there is none.

    >>> mixed_word("ORB-SL\u0410M") == "SL\u0410M", mixed_word("\u03b1-SLAM")
    (True, None)
    """
    for word in re.findall(r"[^\W\d_]+", text):
        if LIKE_LATIN.search(word) and LATIN.search(word):
            return str(word)
    return None


def disguised(text: str) -> str | None:
    """First character that is an ordinary letter or digit in another form: wide, bold, circled, a ligature. None where
    there is none; a superscript or subscript, as in m\N{SUPERSCRIPT TWO}, is no disguise.

    >>> disguised("\uff23arp") == "\uff23", disguised("5 \u00b5m, m\u00b2")
    (True, None)
    """
    for c in text:
        cut = unicodedata.decomposition(c).partition(" ")[0]
        plain = compatible(c)
        if cut in ("<wide>", "<narrow>", "<font>", "<circle>", "<compat>") and plain.isascii() and plain.isalnum():
            return c
    return None


def composed(text: str) -> str:
    """Text with each accented letter as one character (NFC), where macOS may write letter and accent as two.

    >>> composed("e\N{COMBINING ACUTE ACCENT}") == "\N{LATIN SMALL LETTER E WITH ACUTE}"
    True
    """
    return unicodedata.normalize("NFC", text)


def spellings(text: str) -> set[str]:
    """A text as it is, and with accented letters composed, and with all of them apart: those that look the same."""
    return {text, composed(text), unicodedata.normalize("NFD", text)}


def alike(name: str) -> str:
    """Key that names share if a reader may confuse them: letters and digits only, without case and accents, with one
    character for 1, l and I, and one for 0 and O.

    >>> alike("R\N{LATIN SMALL LETTER E WITH ACUTE}ef Lab 10") == alike("reef-lab_lO"), alike("C++"), alike("!")
    (True, 'c', '!')
    """
    letters = "".join(c for c in unicodedata.normalize("NFKD", name).casefold() if c.isalnum())
    return letters.translate(str.maketrans("i10", "llo")) or name


def compatible(text: str) -> str:
    """Replace compatibility characters, such as wide letters, ligatures and circled digits, by ordinary ones (NFKC)."""
    return unicodedata.normalize("NFKC", text)
