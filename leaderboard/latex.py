"""Text in LaTeX: nothing in it is a command, and what a font or an engine must have for it is said."""

from __future__ import annotations

import re

from oysterbench.report.formats import LATEX_NEEDS, latex_escape

SYMBOLS = {
    "\N{DOWNWARDS ARROW}": r"$\downarrow$",
    "\N{UPWARDS ARROW}": r"$\uparrow$",
    "\N{RIGHTWARDS ARROW}": r"$\rightarrow$",
    "\N{MULTIPLICATION SIGN}": r"$\times$",
    "\N{PLUS-MINUS SIGN}": r"$\pm$",
    "\N{LESS-THAN OR EQUAL TO}": r"$\leq$",
    "\N{GREATER-THAN OR EQUAL TO}": r"$\geq$",
    "\N{DEGREE SIGN}": r"$^{\circ}$",
    "\N{MICRO SIGN}": r"$\mu$",
    "\N{GREEK SMALL LETTER MU}": r"$\mu$",
    "\N{MIDDLE DOT}": r"$\cdot$",
    "\N{SUPERSCRIPT THREE}": r"\textsuperscript{3}",
    "\N{HORIZONTAL ELLIPSIS}": r"\ldots{}",
    "\N{EM DASH}": "---",
    "\N{LEFT SINGLE QUOTATION MARK}": "`",
    "\N{RIGHT SINGLE QUOTATION MARK}": "'",
    "\N{LEFT DOUBLE QUOTATION MARK}": "``",
    "\N{RIGHT DOUBLE QUOTATION MARK}": "''",
    "\N{NO-BREAK SPACE}": " ",
    "\N{NARROW NO-BREAK SPACE}": r"\,",
}
"""Characters that pdfLaTeX does not know by themselves, or only in some fonts."""

LIGATURES = ("--", ",,", "''", "``", "!`", "?`")
"""What TeX would set as one character."""

AFTER_LINES = ("[", "*")
"""What would be taken for a part of the line break before it."""

LATIN = re.compile("[\u00a1-\u017f]")
"""Letters and signs that the encoding T1 has."""

OTHER = re.compile("[^\x00-\x7f\u00a1-\u017f]")


def escape(text: str) -> str:
    """A cell or a title."""
    text = " ".join(re.split(r"[ \t\r\n]+", text.strip()))
    found = []
    for i, character in enumerate(text):
        found.append(SYMBOLS.get(character) or (character if character in AFTER_LINES else latex_escape(character)))
        if text[i : i + 2] in LIGATURES:
            found.append("{}")
    written = "".join(found)
    return f"{{{written}}}" if text.startswith(AFTER_LINES) else written


def needs(written: str) -> list[str]:
    """Comments for the head of a file: the packages, and the engine, that what follows needs."""
    said = [LATEX_NEEDS]
    code = re.sub(r"(?m)(?<!\\)%.*$", "", written)
    if LATIN.search(code):
        said.append("% needs \\usepackage[T1]{fontenc}")
    if others := "".join(dict.fromkeys(OTHER.findall(code))):
        said.append(f"% needs lualatex or xelatex, and a font that has {' '.join(others)}")
    return said
