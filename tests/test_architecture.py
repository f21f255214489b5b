"""Who may import whom, and who owns which external package: docs/decisions/0002-layout.md.

Each rule is one test that lists all offenders.
"""

import pytest

from sources import Import, code, offenders

LAYERS = [
    {"arrays", "blas"},
    {"records", "status", "errors", "numerics", "polynomials", "precision", "batching", "compilation"}
    | {"versions", "config", "weights", "mjcf_probe", "validation", "files", "names", "programs"}
    | {"closure", "kept", "native", "linking"},
    {"spline"},
    {"minsnap", "vehicle", "world"},
    {"prediction", "search", "knots", "policy", "arrival", "selection", "tracking", "feasibility"} | {"optimizer"},
    {"planner"},
    {"viz", "io", "interception", "scenario", "replanner", "metrics", "training", "reference"}
    | {"runtime", "mavlink", "device"},
    {"runner"},
    {"cli", "experiments", "benchmarks", "tools", "jaxplan"},
]
"""From the bottom up. ``jaxplan`` is the package's own __init__: the public names."""

SIBLINGS = {
    ("names", "errors"),
    ("programs", "errors"),
    ("programs", "files"),
    ("programs", "versions"),
    ("kept", "closure"),
    ("native", "linking"),
    ("compilation", "native"),
    ("kept", "programs"),
    ("kept", "versions"),
    ("precision", "kept"),
    ("weights", "names"),
    ("config", "errors"),
    ("config", "validation"),
    ("versions", "errors"),
    ("weights", "errors"),
    ("weights", "files"),
    ("weights", "validation"),
    ("mjcf_probe", "errors"),
    ("validation", "errors"),
    ("files", "errors"),
    ("minsnap", "vehicle"),
    ("prediction", "search"),
    ("optimizer", "search"),
    ("optimizer", "tracking"),
    ("scenario", "io"),
    ("scenario", "replanner"),
    ("interception", "scenario"),
    ("interception", "replanner"),
    ("metrics", "interception"),
    ("runtime", "replanner"),
    ("runtime", "scenario"),
    ("interception", "runtime"),
    ("device", "interception"),
    ("device", "io"),
    ("device", "replanner"),
    ("viz", "io"),
    ("mavlink", "runtime"),
    ("mavlink", "replanner"),
    ("mavlink", "io"),
}
"""Imports within one layer, and only these."""

TYPES_ONLY = {
    ("io", "replanner"),
    ("viz", "interception"),
    ("viz", "replanner"),
    ("viz", "scenario"),
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
    "numba": ("jaxplan/native.py", "jaxplan/linking.py", "jaxplan/search/"),
    "threadpoolctl": ("jaxplan/blas.py",),
    "cyclopts": ("jaxplan/cli/", "experiments/"),
    "matplotlib": ("jaxplan/viz/", "experiments/figures/", "benchmarks/_figure.py", "tools/replan_pictures.py"),
    "viser": ("jaxplan/viz/",),
    "mcap": ("jaxplan/io/",),
    "mcap_ros2": ("jaxplan/io/",),
    "pyulog": ("jaxplan/io/",),
    "pymavlink": ("jaxplan/mavlink/", "benchmarks/bench_mavlink.py"),
    "dask": ("jaxplan/runner/",),
    "distributed": ("jaxplan/runner/",),
}


def layer(member: str) -> int:
    return next(i for i, members in enumerate(LAYERS) if member in members)


def imported_station(module: str) -> str | None:
    """The layer member that an import of ours goes to; None for other people's packages."""
    parts = module.split(".")
    if parts[0] in {"experiments", "benchmarks", "tools"}:
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
    if importer in {"cli", "experiments", "benchmarks", "tools"} and target in {"jaxplan", "experiments", "benchmarks"}:
        return None
    if same and ((importer, target) in SIBLINGS or (found.typing and (importer, target) in TYPES_ONLY)):
        return None
    return f"line {found.line}: {importer} may not import {found.module}"


def test_every_station_has_a_layer() -> None:
    assert {source.station for source in code()} <= set().union(*LAYERS)


def test_imports_go_downwards() -> None:
    found = ((source, complaint(source.station, item)) for source in code() for item in source.imports())
    assert offenders((source, text) for source, text in found if text) == []


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Sets of modules that import each other, directly or not (Tarjan's strongly connected components)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(module: str) -> None:
        index[module] = low[module] = len(index)
        stack.append(module)
        for other in sorted(edges[module]):
            if other not in index:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], index[other])
        if low[module] == index[module]:
            part = [stack.pop()]
            while part[-1] != module:
                part.append(stack.pop())
            if len(part) > 1 or module in edges[module]:
                found.append(sorted(part))

    for module in sorted(edges):
        if module not in index:
            visit(module)
    return found


def module_of(dotted: str, known: set[str]) -> str | None:
    """The module of ours that ``import dotted`` or ``from ... import`` reads."""
    while dotted and dotted not in known:
        dotted = dotted.rpartition(".")[0]
    return dotted or None


def test_no_modules_import_in_a_circle() -> None:
    """Inside a folder too, imports within functions included; what only the type checker sees is left out."""
    known = {source.module for source in code()}
    edges: dict[str, set[str]] = {module: set() for module in known}
    for source in code():
        for item in source.imports():
            target = module_of(item.module, known)
            if target and not item.typing and target not in {source.module, "jaxplan"}:
                edges[source.module].add(target)
    assert circles(edges) == []


def test_external_packages_have_owners() -> None:
    wrong = []
    for source in code():
        for item in source.imports():
            owners = OWNERS.get(item.module.split(".")[0])
            if owners and not source.name.startswith(owners):
                wrong.append((source, f"line {item.line}: {item.module} belongs to {', '.join(owners)}"))
    assert offenders(wrong) == []


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


def test_a_circle_is_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [["b", "c"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
