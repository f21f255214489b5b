"""Pages of the API reference: one for each public name, one for each public module that the docs name."""

import ast
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import jaxplan

PACKAGE = Path(jaxplan.__file__).parent

GROUPS: Mapping[str, tuple[str, ...]] = {
    "Plan": ("build_planner", "Planner", "PlannerConfig", "Plans", "select", "Replanner", "PlanStatus", "Reason"),
    "Predict": ("ObservationStream", "build_predictor", "PredictionConfig", "Candidates", "candidates_from"),
    "Trajectories": (
        *("minimum_snap", "minimum_snap_batch", "time_allocation"),
        *("PiecewisePolynomial", "FlatState", "hover"),
    ),
    "Worlds": ("load_world", "World", "clearance", "update_world", "with_spare_boxes"),
    "Vehicles": ("load_vehicle", "Vehicle", "differential_flatness", "rotor_limit_margin"),
    "Policies": ("load_policy", "constant_speed_policy", "load_classifier", "Classifier"),
    "Flights": ("run", "InterceptConfig", "load_target", "track", "TrackConfig"),
    "Errors": ("JaxplanError", "InputError", "FileError"),
}
"""The public names by what they are for."""

MODULES = (
    *("jaxplan.arrival", "jaxplan.knots", "jaxplan.selection", "jaxplan.search.lattice", "jaxplan.planner.refined"),
    *("jaxplan.planner.capture", "jaxplan.planner.fallbacks", "jaxplan.prediction.futures"),
    *("jaxplan.planner.records", "jaxplan.replanner.records", "jaxplan.runtime", "jaxplan.io.export"),
    *("jaxplan.prediction.observations", "jaxplan.prediction.mixture", "jaxplan.world.update", "jaxplan.interception"),
    *("jaxplan.minsnap.many", "jaxplan.minsnap.spline_batch", "jaxplan.tracking.result", "jaxplan.vehicle.identity"),
)
"""Modules whose names public signatures mention; those that the docs name come to them."""

_DOTTED = re.compile(r"(?<![\w./-])jaxplan((?:\.[a-z_][a-z_0-9]*)+)")


def modules_named_in(texts: Iterable[str]) -> set[str]:
    """Modules of the package that texts mention, with or without a name inside them."""
    found = set()
    for text in texts:
        for dotted in _DOTTED.findall(text):
            parts = dotted.strip(".").split(".")
            while parts and not _file_of(parts).is_file():
                parts.pop()
            if parts and not any(part.startswith("_") for part in parts) and parts[0] != "cli":
                found.add(".".join(("jaxplan", *parts)))
    return found


def api_pages(texts: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Paths in the site and the Markdown of the pages; ``texts`` are those of the docs."""
    modules = sorted({*MODULES, *modules_named_in(texts)})
    yield "api/index.md", _index(modules)
    for names in GROUPS.values():
        for name in names:
            yield f"api/{name}.md", _object(name, f"{jaxplan._HOME_OF[name]}.{name}")
    for module in modules:
        yield f"api/{module}.md", _object(module, module, ("show_root_full_path: true",))


def _object(title: str, path: str, options: Iterable[str] = ()) -> str:
    """A page that is mkdocstrings' block for an object; its heading is the page's."""
    told = "".join(f"\n      {option}" for option in ("heading_level: 1", *options))
    return f"---\ntitle: {title}\n---\n\n::: {path}\n    options:{told}\n"


def _index(modules: Iterable[str]) -> str:
    lines = [
        "# API",
        "",
        "The names of `jaxplan` itself. They are imported when they are first used; the errors are at the end.",
        "Lengths are metres, times seconds, angles radians: [symbols, units, frames](../glossary.md).",
    ]
    for title, names in GROUPS.items():
        lines += ["", f"## {title}", "", "| name | |", "|---|---|"]
        lines += [f"| [`{name}`]({name}.md) | {_summary(jaxplan._HOME_OF[name], name)} |" for name in names]
    lines += [
        "",
        "## Modules",
        "",
        "What the guides and the signatures above refer to.",
        "",
        "| module | |",
        "|---|---|",
    ]
    lines += [f"| [`{module}`]({module}.md) | {_summary(module)} |" for module in modules]
    return "\n".join(lines) + "\n"


def _file_of(parts: Iterable[str]) -> Path:
    """The file of ``jaxplan.a.b``: a module or a package."""
    base = PACKAGE.joinpath(*parts)
    return base / "__init__.py" if base.is_dir() else base.with_suffix(".py")


def _summary(module: str, name: str | None = None) -> str:
    """The first line of a docstring, read without importing."""
    file = _file_of(module.split(".")[1:])
    tree = ast.parse(file.read_text(encoding="utf-8"))
    if name is None:
        return _first_line(tree, module)
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return _first_line(node, name)
        if isinstance(node, ast.ImportFrom) and node.module and name in {alias.name for alias in node.names}:
            return _summary(node.module, name)
    raise LookupError(f"{name!r} is not in {file}")


def _first_line(node: ast.Module | ast.ClassDef | ast.FunctionDef, name: str) -> str:
    text = ast.get_docstring(node)
    if not text:
        raise LookupError(f"{name} has no docstring")
    return text.split("\n\n")[0].replace("\n", " ").replace("|", "\\|")
