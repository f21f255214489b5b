"""Timing and records shared by the benchmarks."""

import json
import os
import platform
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxplan.files import write_atomically
from jaxplan.runner.provenance import commit, processor

PACKAGES = ("jax", "jaxlib", "numpy", "scipy", "numba", "scikit-image", "minsnap-trajectories", "rotorpy")


def timed(function: Callable[..., Any], *arguments: Any, repeats: int = 20) -> dict[str, float]:
    """First call (with compilation) [s], then minimum and median [ms] of the following ones."""
    began = time.perf_counter()
    jax.block_until_ready(function(*arguments))
    first = time.perf_counter() - began
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(1e3 * (time.perf_counter() - began))
    return {"first_s": first, "min_ms": min(times), "median_ms": float(np.median(times))}


def machine() -> dict[str, Any]:
    """Hardware, versions and commit: what a number depends on."""
    versions: dict[str, str | None] = {}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = None
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "load_average": os.getloadavg()[0],
        "devices": [str(device) for device in jax.devices()],
        "python": platform.python_version(),
        "versions": versions,
        "commit": commit(),
    }


def write(path: Path, rows: list[dict[str, Any]]) -> None:
    """The rows with the machine's description, as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps({"machine": machine(), "rows": rows}, indent=1) + "\n")


def show(rows: list[dict[str, Any]]) -> None:
    """The rows as a table on the terminal."""
    for row in rows:
        print("  ".join(f"{key} {_short(value)}" for key, value in row.items()))


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
