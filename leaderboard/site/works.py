"""Short names of methods' papers and programs on pages, with an address where they have one."""

from __future__ import annotations

import re
from dataclasses import replace

from oysterbench.core.text import web_host
from oysterbench.report.table import Cell

ADDRESS = re.compile(r"https?://[^\s<>\"]+[^\s<>\".,;)]")
ARXIV = re.compile(r"\barXiv[: ]*(\d{4}\.\d{4,5})", re.IGNORECASE)
DOI = re.compile(r"\bdoi[: ]*(10\.\d{4,9}/[^\s<>\"]+[^\s<>\".,;)])", re.IGNORECASE)
YEAR = re.compile(r"\b((?:19|20)\d\d)\b(?!\.\d)")
INITIALS = re.compile(r"^(?:\w\.[- ]?)+")
FORGES = ("github.com", "gitlab.com", "codeberg.org", "bitbucket.org")
MOST_NAME = 40


def code_cell(code: str) -> Cell:
    """Cell with the name of the program, linked to it. code: where it is."""
    return Cell(code or None, code_name(code) or None, url=code if ADDRESS.fullmatch(code) and web_host(code) else "")


def paper_cell(paper: str) -> Cell:
    """Cell with first author and year, linked to the paper. paper: a citation, such as "A. Author, B. Author: Title.
    Venue 2020, doi:..."."""
    return Cell(paper or None, paper_name(paper) or None, about=paper, url=paper_address(paper))


def work_cell(code: str, paper: str) -> Cell:
    """Cell with the program, and the paper below it; with only one of them where the other is missing."""
    named, cited = code_cell(code), paper_cell(paper)
    if not code or not paper:
        return named if code else cited
    return replace(named, about=paper, small=cited.text or "", small_url=cited.url)


def code_name(place: str) -> str:
    """Short name of a program: the last part of a repository's address or of a path; for other addresses, the host.

    >>> code_name("https://github.com/rpng/open_vins"), code_name("https://colmap.github.io/x")
    ('open_vins', 'colmap.github.io')
    """
    host = web_host(place).removeprefix("www.") if ADDRESS.fullmatch(place) else ""
    own = place.strip("/").removesuffix(".git").rpartition("/")[2]
    return (host if host and host not in FORGES else own)[:MOST_NAME]


def paper_name(citation: str) -> str:
    """First author and year of a citation, of the first where there are several; "paper" where they cannot be found.

    >>> paper_name("C. Campos, R. Elvira: ORB-SLAM3. IEEE T-RO 37(6), 2021"), paper_name("S. Leutenegger: OKVIS2. 2022")
    ('Campos et al. 2021', 'Leutenegger 2022')
    >>> paper_name("https://example.org/paper.pdf")
    'paper'
    """
    if not citation:
        return ""
    first = ADDRESS.sub("", citation).partition(";")[0]
    authors, years = first.partition(":")[0].split(","), YEAR.findall(first)
    name = INITIALS.sub("", authors[0].strip())
    if not name or not years or len(name) > MOST_NAME:
        return "paper"
    return f"{name}{' et al.' if len(authors) > 1 else ''} {years[-1]}"


def paper_address(citation: str) -> str:
    """Address where a cited paper can be read: a URL in the text, a DOI or an arXiv number; empty without any."""
    if (found := ADDRESS.search(citation)) and web_host(found[0]):
        return found[0]
    if found := DOI.search(citation):
        return f"https://doi.org/{found[1]}"
    if found := ARXIV.search(citation):
        return f"https://arxiv.org/abs/{found[1]}"
    return ""
