"""A reader of LaTeX that knows the tables which are written here, and refuses all else: for machines without LaTeX."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

ARGUMENTS = {
    "caption": 1,
    "label": 1,
    "textbf": 1,
    "textsuperscript": 1,
    **dict.fromkeys(("centering", "toprule", "midrule", "bottomrule"), 0),
    **dict.fromkeys(("textbackslash", "textasciitilde", "textasciicircum", "textless", "textgreater", "textbar"), 0),
    "ldots": 0,
}
"""Command of text -> arguments in braces."""

WITH_BRACES = ("textbackslash", "textasciitilde", "textasciicircum", "textless", "textgreater", "textbar", "ldots")
"""Commands after which a blank would be lost."""

MATHS = {r"$\downarrow$", r"$\uparrow$", r"$\rightarrow$", r"$\times$", r"$\pm$", r"$\leq$", r"$\geq$", r"$^{\circ}$"}
MATHS |= {r"$\mu$", r"$\cdot$", "$-$"}
SIGNS = "&%$#_{},"
"""What may follow a backslash."""

READ = {
    "textbackslash": "\\",
    "textasciitilde": "~",
    "textasciicircum": "^",
    "textless": "<",
    "textgreater": ">",
    "textbar": "|",
    "ldots": "\N{HORIZONTAL ELLIPSIS}",
}
LIGATURES = {"---": "\N{EM DASH}", "--": "\N{EN DASH}", "``": "\N{LEFT DOUBLE QUOTATION MARK}"}
LIGATURES |= {
    "''": "\N{RIGHT DOUBLE QUOTATION MARK}",
    ",,": "\N{DOUBLE LOW-9 QUOTATION MARK}",
    "!`": "\u00a1",
    "?`": "\u00bf",
}
"""What is set as one character."""

FITTED = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{"
"""Around a tabular: made smaller where it is wider than the line, never larger."""

TOKEN = re.compile(r"\\[A-Za-z]+|\\.|\$[^$]*\$|---|--|``|''|,,|!`|\?`|.", re.DOTALL)


class Wrong(Exception):
    """What LaTeX would stop at, or set as something else."""


@dataclass
class Table:
    """columns: of the tabular; rows: of cells, as a reader of the paper sees them; caption, label: the same."""

    columns: str
    rows: list[list[str]] = field(default_factory=list)
    caption: str = ""
    label: str = ""


def needed(text: str) -> set[str]:
    """What the head of a file says that it needs, in one word each."""
    head = text.split("\\begin", 1)[0]
    known = ("booktabs", "graphicx", "fontenc", "lualatex")
    return {word for word in known if re.search(f"(?m)^% needs .*{word}", head)}


def read(text: str) -> list[Table]:
    """All tables of a file. Raises Wrong."""
    known = needed(text)
    bare = "\n".join(re.sub(r"(?<!\\)((?:\\\\)*)%.*$", r"\1", line) for line in text.split("\n"))
    if "booktabs" not in known and "rule" in bare:
        raise Wrong("nobody is told of booktabs")
    if "graphicx" not in known and FITTED in bare:
        raise Wrong("nobody is told of graphicx")
    for character in set(bare) - set(map(chr, range(32, 127))) - {"\n"}:
        if "lualatex" not in known and not ("fontenc" in known and "\u00a1" <= character <= "\u017f"):
            raise Wrong(f"pdflatex does not know {character!r}")
    bodies = re.findall(r"\\begin\{table\}(.*?)\\end\{table\}", bare, re.DOTALL)
    if re.sub(r"\\begin\{table\}(.*?)\\end\{table\}", "", bare, flags=re.DOTALL).strip():
        raise Wrong("something stands outside of the tables")
    return [_table(body) for body in bodies]


def _table(body: str) -> Table:
    found = re.fullmatch(
        r"\s*\\centering\s*(?P<head>.*?)" + re.escape(FITTED) + r"\s*\\begin\{tabular\}\{(?P<columns>[lr]+)\}"
        r"(?P<rows>.*)\\end\{tabular\}\}\s*",
        body,
        re.DOTALL,
    )
    if found is None:
        raise Wrong(f"no table: {body[:80]!r}")
    table = Table(found["columns"])
    for command, argument in re.findall(r"\\(caption|label)(\{.*\})\s*\n", found["head"]):
        setattr(table, command, shown(argument))
    lines = re.split(r"(?<!\\)\\\\(?=\s)", found["rows"])
    if shown(re.sub(r"\\bottomrule", "", lines.pop())).strip():
        raise Wrong("a row does not end")
    for line in lines:
        row = re.sub(r"^\s*(\\(?:toprule|midrule)\s+)*", "", line)
        if row.startswith(("[", "*")):
            raise Wrong(f"taken for a part of the line break before it: {row[:40]!r}")
        cells = re.split(r"(?<!\\)&", row)
        if len(cells) != len(table.columns):
            raise Wrong(f"{len(cells)} cells in {len(table.columns)} columns: {row!r}")
        table.rows.append([shown(cell.strip()) for cell in cells])
    return table


def shown(text: str) -> str:
    """What is read on paper. Raises Wrong where a brace, a command or a character is not as it must be."""
    tokens = TOKEN.findall(text)
    out, depth = [], 0
    for i, token in enumerate(tokens):
        after = tokens[i + 1] if i + 1 < len(tokens) else ""
        if token == "{":
            depth += 1
        elif token == "}":
            depth -= 1
            if depth < 0:
                raise Wrong(f"a brace closes nothing: {text!r}")
        elif token.startswith("$"):
            if token not in MATHS:
                raise Wrong(f"not our mathematics: {token!r}")
            out.append(token)
        elif token.startswith("\\") and token[1:].isalpha():
            name = token[1:]
            if name not in ARGUMENTS:
                raise Wrong(f"not our command: {token}")
            if (ARGUMENTS[name] or name in WITH_BRACES) and after != "{":
                raise Wrong(f"{token} without braces: {text!r}")
            out.append(READ.get(name, ""))
        elif token.startswith("\\"):
            if len(token) < 2 or token[1] not in SIGNS:
                raise Wrong(f"not our sign: {token!r} in {text!r}")
            out.append(" " if token == "\\," else token[1])
        elif token in set("#^_&~%$"):
            raise Wrong(f"bare {token!r} in {text!r}")
        else:
            out.append(LIGATURES.get(token, token))
    if depth:
        raise Wrong(f"a brace is left open: {text!r}")
    return "".join(out)
