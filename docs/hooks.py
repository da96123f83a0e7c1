"""MkDocs hooks: generated pages, pages from the repository's folders, links, and equations."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

sys.path.insert(0, str(Path(__file__).parents[1]))

from docs.equations import with_mathml
from docs.generate import generated_pages
from docs.generate.repository import ROOT, linked_files, repository_pages, site_links


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are not in `docs/`, and the files that any page links to."""
    texts = {file.src_uri: file.content_string for file in files.documentation_pages()}
    texts |= {place: path.read_text(encoding="utf-8") for place, path in repository_pages().items()}
    generated = generated_pages()
    texts |= generated
    for place in (*repository_pages(), *generated):
        files.append(File.generated(config, place, content=texts[place]))
    for path in linked_files(texts):
        if files.get_file_from_path(path) is None and not path.startswith("docs/"):
            files.append(File.generated(config, path, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Convert links to those of the site."""
    return site_links(markdown, page.file.src_uri, lambda path: None)


def on_page_content(content: str, **_: Any) -> str:
    """Convert equations to MathML, which needs no script."""
    return with_mathml(content)
