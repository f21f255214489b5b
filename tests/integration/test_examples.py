"""The examples run and print what their pages show; the notebooks are those scripts, and run as well.

Numbers may differ from machine to machine: words have to be the same, numbers near.
"""

import json
import re
import subprocess
from pathlib import Path

import pytest

from tools.notebooks import FOLDER, cells_of, chosen, notebook_of, run_notebook
from tools.record_examples import run_example
from tools.site.examples import OUTPUTS, code_of, scripts, title_and_text

NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
FAST = ("02", "09")
"""Numbers of the examples that take a few seconds."""
NEEDS = {"09": "pymavlink", "10": "distributed"}
NEAR = {"rel": 0.15, "abs": 0.06}
"""How near numbers have to be: rounding, and flights that differ a little with the version of JAX."""


def number_of(script: Path) -> str:
    return script.name.split("_")[0]


def examples(fast: bool) -> list[Path]:
    return [script for script in scripts() if (number_of(script) in FAST) == fast]


def compare(printed: str, kept: str) -> None:
    """Raise AssertionError where words differ, or numbers by more than ``NEAR``."""
    assert [NUMBER.sub("#", line).split() for line in printed.splitlines()] == [
        NUMBER.sub("#", line).split() for line in kept.splitlines()
    ], printed
    found, expected = ([float(number) for number in NUMBER.findall(text)] for text in (printed, kept))
    assert found == pytest.approx(expected, **NEAR), printed


def run_and_compare(script: Path, folder: Path) -> None:
    if number_of(script) in NEEDS:
        pytest.importorskip(NEEDS[number_of(script)])
    compare(run_example(script, folder), (OUTPUTS / f"{script.stem}.txt").read_text(encoding="utf-8"))


@pytest.mark.parametrize("script", examples(fast=True), ids=number_of)
def test_quick_examples_print_what_the_site_shows(script: Path, tmp_path: Path) -> None:
    run_and_compare(script, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("script", examples(fast=False), ids=number_of)
def test_examples_print_what_the_site_shows(script: Path, tmp_path: Path) -> None:
    run_and_compare(script, tmp_path)


def test_a_failing_example_is_no_output(tmp_path: Path) -> None:
    (tmp_path / "examples").mkdir()
    script = tmp_path / "examples" / "bad.py"
    script.write_text("print('one')\nraise SystemExit(3)\n")
    with pytest.raises(subprocess.CalledProcessError):
        run_example(script, tmp_path)


@pytest.mark.parametrize("printed", ["met after 1.5 s", "met after 1.1 s, twice", "met", ""])
def test_other_output_is_told(printed: str) -> None:
    compare("met after 1.02 s", "met after 1.00 s")
    with pytest.raises(AssertionError):
        compare(printed, "met after 1.00 s")


def test_there_are_ten_of_them_and_none_is_long() -> None:
    assert [number_of(script) for script in scripts()] == [f"{number:02}" for number in range(1, 11)]
    for script in scripts():
        title, text = title_and_text(script)
        assert title
        assert text
        assert len(code_of(script).splitlines()) <= 80


@pytest.mark.parametrize("script", chosen(), ids=number_of)
def test_notebooks_are_their_scripts(script: Path) -> None:
    notebook = json.loads((FOLDER / f"{script.stem}.ipynb").read_text(encoding="utf-8"))
    assert [(cell["cell_type"], "".join(cell["source"])) for cell in notebook["cells"]] == cells_of(script)
    shown = "".join(text for output in notebook["cells"][-1]["outputs"] for text in output["text"])
    compare(shown, (OUTPUTS / f"{script.stem}.txt").read_text(encoding="utf-8"))


@pytest.mark.slow
@pytest.mark.parametrize("script", chosen(), ids=number_of)
def test_notebooks_run(script: Path, tmp_path: Path) -> None:
    pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    notebook = notebook_of(script)
    run_notebook(notebook, tmp_path)
    shown = "".join(output["text"] for output in notebook.cells[-1].outputs)
    compare(shown, (OUTPUTS / f"{script.stem}.txt").read_text(encoding="utf-8"))
