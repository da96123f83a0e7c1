"""How to cite: CITATION.cff as BibTeX, and what else to name."""

from __future__ import annotations

from docs.generate.markdown import fence
from docs.generate.repository import ROOT

PAGE = """# How to cite

Cite the software with its version, and name split and evaluator with theirs, as results print them: "slam-val 1.0,
evaluator slam 3".

{bibtex}
The same for machines: [CITATION.cff](../CITATION.cff).

Rendered data is under CC BY 4.0: name oysterbench and the split. The code is under the MIT licence. Published systems
that are run are to be cited as their authors ask: [each page](../baselines/external/README.md) names the paper.

Who publishes results may send them to [the leaderboard](../leaderboard/README.md), or attach `results.json`: it holds
versions, settings, machine and every metric.
"""


def citation_page() -> str:
    """The page."""
    from ruamel.yaml import YAML

    cited = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    authors = " and ".join(f"{{{author['name']}}}" for author in cited["authors"])
    fields = {"title": f"{{{cited['title']}}}", "author": authors} | {key: cited[key] for key in ("version", "license")}
    lines = ",\n".join(f"  {key:7} = {{{value}}}" for key, value in fields.items())
    return PAGE.format(bibtex=fence(f"@software{{oysterbench,\n{lines}\n}}", "bibtex"))
