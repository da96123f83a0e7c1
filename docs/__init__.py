"""The documentation site: pages in Markdown, and `generate`, which makes the others from the code."""
