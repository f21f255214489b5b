"""Tables as CSV, Markdown and LaTeX."""

import csv
import io
import math
from collections.abc import Sequence
from typing import Any

_SPECIAL = {"\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "_": r"\_", "#": r"\#", "$": r"\$", "±": r"$\pm$"}


def as_csv(rows: Sequence[dict[str, Any]]) -> str:
    """One line for each row, floats in full; columns in the order in which they first occur."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def as_markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table with the first column to the left and the others to the right."""
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def as_latex(header: Sequence[str], rows: Sequence[Sequence[str]], caption: str) -> str:
    """The same as a floating table; needs no packages."""

    def line(cells: Sequence[str]) -> str:
        return " & ".join("".join(_SPECIAL.get(letter, letter) for letter in cell) for cell in cells) + r" \\"

    head = [r"\begin{table}", r"\centering", rf"\caption{{{line([caption])[:-3]}}}"]
    columns = "l" + "r" * (len(header) - 1)
    body = [rf"\begin{{tabular}}{{{columns}}}", r"\hline", line(header), r"\hline", *map(line, rows), r"\hline"]
    return "\n".join([*head, *body, r"\end{tabular}", r"\end{table}"]) + "\n"


def number(value: float | None, form: str = ".3f") -> str:
    """A number in the given format; a dash where there is none, or none that is finite."""
    return "-" if value is None or not math.isfinite(value) else format(value, form)


def duration(seconds: float) -> str:
    """A time for people: 42 s, 13 min, 5.2 h."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
