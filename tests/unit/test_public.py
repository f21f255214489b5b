"""The public list: short, the same for people, for type checkers and for editors."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import jaxplan

PACKAGE = Path(jaxplan.__file__).parent
PUBLIC = [
    "Candidates",
    "Classifier",
    "FileError",
    "FlatState",
    "InputError",
    "InterceptConfig",
    "JaxplanError",
    "ObservationStream",
    "PiecewisePolynomial",
    "PlanStatus",
    "Planner",
    "PlannerConfig",
    "Plans",
    "PredictionConfig",
    "Reason",
    "Replanner",
    "TrackConfig",
    "Vehicle",
    "World",
    "build_planner",
    "build_predictor",
    "candidates_from",
    "clearance",
    "constant_speed_policy",
    "differential_flatness",
    "hover",
    "load_classifier",
    "load_policy",
    "load_target",
    "load_vehicle",
    "load_world",
    "minimum_snap",
    "minimum_snap_batch",
    "rotor_limit_margin",
    "run",
    "select",
    "time_allocation",
    "track",
    "update_world",
    "with_spare_boxes",
]


def test_the_version_is_that_of_the_project() -> None:
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["project"]
    assert jaxplan.__version__ == project["version"]


def test_the_list_is_this_one() -> None:
    assert jaxplan.__all__ == sorted(PUBLIC)
    assert len(PUBLIC) <= 40


def test_every_public_name_is_there_and_documented() -> None:
    undocumented = [name for name in PUBLIC if not (getattr(jaxplan, name).__doc__ or "").strip()]
    assert undocumented == []


def test_the_stub_names_the_same_homes() -> None:
    tree = ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8"))
    stated = {
        alias.asname: node.module for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert stated == jaxplan._HOME_OF


def test_a_type_checker_of_a_user_knows_the_types(tmp_path: Path) -> None:
    """py.typed and the stub: a wrong use of a public name is an error in a user's own file."""
    pytest.importorskip("mypy")
    script = tmp_path / "script.py"
    script.write_text(
        "import jaxplan\n"
        "config: jaxplan.PlannerConfig = jaxplan.PlannerConfig(padding=0.3)\n"
        "reveal_type(jaxplan.load_world('env1'))\n"
        "jaxplan.PlannerConfig(pading=0.3)\n"
        "jaxplan.no_such_name\n"
    )
    command = [sys.executable, "-m", "mypy", "--cache-dir", str(tmp_path / "cache"), "--follow-imports=silent"]
    done = subprocess.run([*command, str(script)], cwd=PACKAGE.parent, capture_output=True, text=True, check=False)
    found = [line.split(": ", 1)[1] for line in done.stdout.splitlines() if line.startswith(str(script))]
    assert any('Revealed type is "jaxplan.world.obstacles.World"' in line for line in found), done.stdout
    assert any('Unexpected keyword argument "pading"' in line for line in found), done.stdout
    assert any('Module has no attribute "no_such_name"' in line for line in found), done.stdout
    assert sum("error:" in line for line in found) == 2, done.stdout


def test_importing_jaxplan_is_instant_and_imports_no_jax() -> None:
    code = "import sys, jaxplan; print(sorted({'jax', 'numpy', 'mujoco', 'matplotlib'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_start_imports_only_what_it_calls() -> None:
    code = "import sys, jaxplan.interception; print(sorted({'mujoco.mjx', 'scipy.interpolate'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
