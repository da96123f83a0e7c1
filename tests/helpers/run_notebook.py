"""Run a notebook in a folder: python -m tests.helpers.run_notebook NOTEBOOK FOLDER; prints what its cells print."""

from __future__ import annotations

import sys

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError


def main() -> None:
    notebook = nbformat.read(sys.argv[1], as_version=4)
    client = NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": sys.argv[2]}})
    try:
        client.execute()
    except CellExecutionError as error:
        sys.exit(str(error))
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            print(output.get("text", ""), end="")


if __name__ == "__main__":
    main()
