"""Pages of the examples: what a script's docstring says, its code, and what it printed and drew."""

import ast
import shutil
from collections.abc import Iterator
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
OUTPUTS = EXAMPLES / "outputs"


def scripts() -> list[Path]:
    """The examples, in their order."""
    return sorted(EXAMPLES.glob("[0-9]*.py"))


def title_and_text(script: Path) -> tuple[str, str]:
    """The first line of a script's docstring without its full stop, and what follows."""
    docstring = ast.get_docstring(ast.parse(script.read_text(encoding="utf-8")))
    if not docstring:
        raise LookupError(f"{script.name} has no docstring")
    title, _, text = docstring.partition("\n\n")
    return title.removesuffix("."), text


def code_of(script: Path) -> str:
    """A script without its docstring."""
    text = script.read_text(encoding="utf-8")
    docstring = ast.parse(text).body[0]
    return "\n".join(text.splitlines()[docstring.end_lineno or 0 :]).strip()


def example_pages(folder: Path) -> Iterator[tuple[str, str]]:
    """Paths in the site and the Markdown of the pages; scripts, notebooks and pictures go into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for script in scripts():
        title, text = title_and_text(script)
        rows.append(f"| [{title}]({script.stem}.md) | {_first_sentence(text)} |")
        yield f"examples/{script.stem}.md", _page(script, title, text, folder)
    lines = [
        "# Examples",
        "",
        "Scripts of about forty lines to run and to change. Each page shows a script and what it printed here; numbers",
        "differ a little from machine to machine. All of them are run by the project's tests.",
        "",
        "```bash",
        "python examples/01_intercept_in_your_map.py    # in a checkout; 09 needs pymavlink, 10 dask",
        "```",
        "",
        "| example | |",
        "|---|---|",
        *rows,
    ]
    yield "examples/index.md", "\n".join(lines) + "\n"


def _page(script: Path, title: str, text: str, folder: Path) -> str:
    parts = [f"# {title}", text, f'```python title="examples/{script.name}"\n{code_of(script)}\n```']
    printed, picture = (OUTPUTS / f"{script.stem}{suffix}" for suffix in (".txt", ".png"))
    parts.append(f"## What it prints\n\n```text\n{printed.read_text(encoding='utf-8').rstrip()}\n```")
    if picture.is_file():
        shutil.copy(picture, folder / picture.name)
        parts.append(f"![{title}]({picture.name})")
    downloads = [script, *(path for path in (EXAMPLES / "notebooks" / f"{script.stem}.ipynb",) if path.is_file())]
    for path in downloads:
        shutil.copy(path, folder / path.name)
    parts.append("Download: " + ", ".join(f"[{path.name}]({path.name})" for path in downloads))
    return "\n\n".join(part for part in parts if part) + "\n"


def _first_sentence(text: str) -> str:
    return text.split("\n\n")[0].replace("\n", " ").split(". ")[0].removesuffix(".") + "."
