"""Who may import whom, who owns which external package, how long a file may be, and what may not be written.

The imports are read with ``ast``; nothing is executed. The rules are docs/decisions/0002-layout.md.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "jaxplan"

LAYERS = [
    {"records", "status", "errors", "numerics", "precision", "batching", "compilation"}
    | {"versions", "config", "weights", "mjcf_probe", "arrays", "validation"},
    {"spline"},
    {"minsnap", "vehicle", "world"},
    {"prediction", "search", "knots", "policy", "arrival", "selection", "tracking", "feasibility"},
    {"planner"},
    {"viz", "io", "interception", "replanner", "metrics", "training"},
    {"runner"},
    {"cli", "experiments", "benchmarks", "jaxplan"},
]
"""From the bottom up. ``jaxplan`` is the package's own __init__: the public names."""

SIBLINGS = {
    ("config", "errors"),
    ("versions", "errors"),
    ("weights", "errors"),
    ("mjcf_probe", "errors"),
    ("validation", "errors"),
    ("interception", "io"),
    ("interception", "replanner"),
    ("metrics", "interception"),
}
"""Imports within one layer, and only these."""

TYPES_ONLY = {
    ("io", "replanner"),
    ("viz", "interception"),
    ("viz", "replanner"),
    ("arrival", "policy"),
}
"""Imports within one layer that are allowed under ``if TYPE_CHECKING``."""

OWNERS = {
    "mujoco": (
        "jaxplan/tracking/",
        "benchmarks/",
        "jaxplan/world/formats/mjcf.py",
        "jaxplan/vehicle/mjcf.py",
    ),
    "flax": ("jaxplan/policy/", "jaxplan/feasibility/", "jaxplan/training/"),
    "optax": ("jaxplan/training/",),
    "sklearn": ("jaxplan/prediction/gmm.py",),
    "numba": ("jaxplan/search/",),
    "cyclopts": ("jaxplan/cli/", "experiments/"),
    "matplotlib": ("jaxplan/viz/", "experiments/figures/", "benchmarks/_figure.py"),
    "viser": ("jaxplan/viz/",),
    "dask": ("jaxplan/runner/",),
    "distributed": ("jaxplan/runner/",),
}

BANNED_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "yaml"}
BANNED_CALLS = {"eval", "exec", "os.system", "yaml.load"}
BANNED_ARGUMENTS = {"allow_pickle", "shell"}

MAX_FILE_LINES = 350
MAX_FUNCTION_LINES = 80
"""Most functions stay below 40; this is the very most."""


class Import(NamedTuple):
    """``module`` is imported at ``line``; ``typing`` where only the type checker sees it."""

    module: str
    line: int
    typing: bool


def sources(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def station(path: Path) -> str:
    """The layer member that a file belongs to."""
    parts = path.relative_to(ROOT).parts
    if parts[0] != "jaxplan":
        return parts[0]
    return "jaxplan" if parts[1] == "__init__.py" else parts[1].removesuffix(".py")


def imports(tree: ast.AST, path: Path, typing: bool = False) -> Iterator[Import]:
    """Every import of a file, inside functions too, with relative ones made absolute."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (Import(alias.name, node.lineno, typing) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = path.relative_to(ROOT).with_suffix("").parts[: -node.level] if node.level else ()
            base = ".".join((*package, *([node.module] if node.module else [])))
            yield from (Import(f"{base}.{alias.name}", node.lineno, typing) for alias in node.names)
        guarded = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        yield from imports(node, path, typing or guarded)


def layer(member: str) -> int:
    return next(i for i, members in enumerate(LAYERS) if member in members)


def imported_station(module: str) -> str | None:
    """The layer member that an import of ours goes to; None for other people's packages."""
    parts = module.split(".")
    if parts[0] in {"experiments", "benchmarks"}:
        return parts[0]
    if parts[0] != "jaxplan":
        return None
    known = set().union(*LAYERS)
    return parts[1] if len(parts) > 1 and parts[1] in known else "jaxplan"


def complaint(importer: str, found: Import) -> str | None:
    """What is wrong with an import of ours, if anything."""
    target = imported_station(found.module)
    if target is None or target == importer:
        return None
    if layer(target) < layer(importer):
        return None
    same = layer(target) == layer(importer)
    if importer in {"cli", "experiments", "benchmarks"} and target in {"jaxplan", "experiments", "benchmarks"}:
        return None
    if same and ((importer, target) in SIBLINGS or (found.typing and (importer, target) in TYPES_ONLY)):
        return None
    return f"line {found.line}: {importer} may not import {found.module}"


CODE = sources("jaxplan", "experiments", "benchmarks")


def test_every_station_has_a_layer() -> None:
    known = set().union(*LAYERS)
    assert {station(path) for path in CODE} <= known


@pytest.mark.parametrize("path", CODE, ids=name)
def test_imports_go_downwards(path: Path) -> None:
    found = imports(ast.parse(path.read_text(encoding="utf-8")), path)
    assert [text for item in found if (text := complaint(station(path), item))] == []


@pytest.mark.parametrize("path", CODE, ids=name)
def test_external_packages_have_owners(path: Path) -> None:
    wrong = []
    for item in imports(ast.parse(path.read_text(encoding="utf-8")), path):
        owners = OWNERS.get(item.module.split(".")[0])
        if owners and not name(path).startswith(owners):
            wrong.append(f"line {item.line}: {item.module} belongs to {', '.join(owners)}")
    assert wrong == []


@pytest.mark.parametrize("path", [*CODE, *sources("tests")], ids=name)
def test_files_and_functions_are_small(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MAX_FILE_LINES
    functions = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
    lengths = {node.name: (node.end_lineno or 0) - node.lineno + 1 for node in functions}
    assert {function: length for function, length in lengths.items() if length > MAX_FUNCTION_LINES} == {}


def banned(path: Path) -> Iterator[str]:
    """What a file does that nothing here may do: run data as code, or hide an error."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for item in imports(tree, path):
        if item.module.split(".")[0] in BANNED_MODULES:
            yield f"line {item.line}: import {item.module}"
    for node in ast.walk(tree):
        if isinstance(node, ast.ExceptHandler) and node.type is None:
            yield f"line {node.lineno}: bare except"
        if isinstance(node, ast.Call):
            if ast.unparse(node.func) in BANNED_CALLS:
                yield f"line {node.lineno}: {ast.unparse(node.func)}("
            for argument in node.keywords:
                false = isinstance(argument.value, ast.Constant) and argument.value.value is False
                if argument.arg in BANNED_ARGUMENTS and not false:
                    yield f"line {node.lineno}: {argument.arg}={ast.unparse(argument.value)}"


@pytest.mark.parametrize("path", [*CODE, *sources("tests")], ids=name)
def test_nothing_banned_is_written(path: Path) -> None:
    assert list(banned(path)) == []


@pytest.mark.parametrize("path", sources("jaxplan"), ids=name)
def test_import_has_no_side_effects(path: Path) -> None:
    """No flags, environment, files or output at import: no such call outside a function or a class."""
    forbidden = re.compile(r"config\.update|environ|^print$|^open$|read_text|np\.load|filterwarnings|\.use$")
    tree = ast.parse(path.read_text(encoding="utf-8"))
    top = [node for node in tree.body if not isinstance(node, ast.FunctionDef | ast.ClassDef | ast.If)]
    calls = [ast.unparse(node.func) for part in top for node in ast.walk(part) if isinstance(node, ast.Call)]
    assert [call for call in calls if forbidden.search(call)] == []


RULES = [
    ("numerics", "jaxplan.spline.hover", False, True),
    ("spline", "jaxplan.numerics.safe_norm", False, False),
    ("search", "jaxplan.world.load", False, False),
    ("search", "jaxplan.policy.network", False, True),
    ("arrival", "jaxplan.policy.network", False, True),
    ("arrival", "jaxplan.policy.network", True, False),
    ("viz", "jaxplan.interception.Episode", True, False),
    ("viz", "jaxplan.interception.Episode", False, True),
    ("planner", "jaxplan.build_planner", False, True),
    ("cli", "jaxplan.interception", False, False),
    ("io", "numpy", False, False),
]


@pytest.mark.parametrize(("importer", "module", "typing", "refused"), RULES)
def test_the_rules_themselves(importer: str, module: str, typing: bool, refused: bool) -> None:
    assert bool(complaint(importer, Import(module, 1, typing))) == refused


def test_the_bans_themselves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    path = tmp_path / "bad.py"
    path.write_text(
        "import pickle\nimport yaml\neval('1')\nnp.load(f, allow_pickle=True)\n"
        "run(c, shell=True)\ntry:\n    pass\nexcept:\n    pass\nnp.load(f, allow_pickle=False)\n"
    )
    assert len(list(banned(path))) == 6
