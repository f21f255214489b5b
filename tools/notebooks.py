"""Notebooks made from examples: ``python -m tools.notebooks`` writes and runs them.

A cell of text for the docstring, one cell for the imports and constants, one for each function, and one that calls
``main()``. What they put out is kept with them.
"""

import ast
from pathlib import Path
from typing import Any

from tools.site.examples import EXAMPLES, scripts, title_and_text

FOLDER = EXAMPLES / "notebooks"
CHOSEN = ("02", "03")
"""Numbers of the examples that are notebooks, too."""


def chosen() -> list[Path]:
    """The scripts of the notebooks."""
    return [script for script in scripts() if script.name.split("_")[0] in CHOSEN]


def cells_of(script: Path) -> list[tuple[str, str]]:
    """Kind ("markdown" or "code") and text of each cell."""
    title, text = title_and_text(script)
    source = script.read_text(encoding="utf-8")
    body = ast.parse(source).body
    lines = source.splitlines()
    cells, start = [("markdown", f"# {title}\n\n{text}")], body[0].end_lineno or 0
    for node in body[1:]:
        if isinstance(node, ast.FunctionDef):
            cells += _code(lines[start : node.lineno - 1]) + _code(lines[node.lineno - 1 : node.end_lineno])
            start = node.end_lineno or 0
    return [*cells, ("code", "main()")]


def _code(lines: list[str]) -> list[tuple[str, str]]:
    text = "\n".join(lines).strip()
    return [("code", text)] if text else []


def notebook_of(script: Path) -> Any:
    """The notebook of a script, not run yet; the same bytes for the same script."""
    import nbformat

    make = {"markdown": nbformat.v4.new_markdown_cell, "code": nbformat.v4.new_code_cell}
    cells = [make[kind](text, id=f"cell-{number}") for number, (kind, text) in enumerate(cells_of(script))]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return nbformat.v4.new_notebook(cells=cells, metadata={"kernelspec": kernel})


def run_notebook(notebook: Any, folder: Path) -> None:
    """Run all cells in place, in a folder. Raises ``CellExecutionError`` where one fails."""
    from nbclient import NotebookClient

    where = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=600, resources=where, record_timing=False).execute()
    for cell in notebook.cells:
        if cell.cell_type == "code":  # what goes to stderr are timings, which differ from run to run
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
    notebook.metadata.pop("language_info", None)


def main() -> None:
    """Write all of them anew."""
    import nbformat

    FOLDER.mkdir(exist_ok=True)
    for script in chosen():
        notebook = notebook_of(script)
        run_notebook(notebook, EXAMPLES)
        nbformat.validate(notebook)
        nbformat.write(notebook, FOLDER / f"{script.stem}.ipynb")
        print(f"{script.stem}.ipynb: {len(notebook.cells)} cells")


if __name__ == "__main__":
    main()
