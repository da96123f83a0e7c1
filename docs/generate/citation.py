"""The page on how to cite: CITATION.cff as BibTeX, and what else to name."""

from __future__ import annotations

from docs.generate.markdown import fence
from docs.generate.repository import ROOT

PAGE = """# How to cite

Cite the software with its version, and name the split and evaluator with their versions, as printed with results:
"slam-val 1.0, evaluator slam 3".

{bibtex}
Machine-readable: [CITATION.cff](../CITATION.cff).

Rendered data and trained weights are under CC BY 4.0: name oysterbench, and the split or the weights. Those of `unet`
began with EfficientNet-Lite0, under the Apache License 2.0. The code is under the MIT licence. Cite published systems
that you run as their authors ask: [each page](../baselines/external/README.md) names the paper.

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
