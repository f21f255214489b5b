"""Fixtures shared by all tests, and two settings of the whole run.

Annotations of ``jaxplan`` are checked at run time, by jaxtyping's import hook with beartype, on the modules that
JAXPLAN_TYPECHECK names (comma-separated; empty: none). With JAXPLAN_STRICT=1 JAX refuses to broadcast ranks and to mix
dtypes, which the library's own code does not need. The library must work without any of this:
``tests/integration/test_docs.py`` runs it in processes of its own.
"""

import ctypes
import gc
import os
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

if "JAX_COMPILATION_CACHE_DIR" not in os.environ:  # what one process compiled no other one of the run compiles again
    _COMPILED = tempfile.TemporaryDirectory(prefix="jaxplan-compiled-")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _COMPILED.name
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
if "JAXPLAN_CACHE_DIR" not in os.environ:  # nor is any roadmap made twice, or left behind
    _STORED = tempfile.TemporaryDirectory(prefix="jaxplan-stored-")
    os.environ["JAXPLAN_CACHE_DIR"] = _STORED.name
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import jax
import pytest
from compilations import CompilationCounter
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

CHECKED = os.environ.get("JAXPLAN_TYPECHECK", "jaxplan")
if CHECKED:
    install_import_hook(CHECKED.split(","), "annotations.check")
if os.environ.get("JAXPLAN_STRICT", "1") == "1":
    jax.config.update("jax_numpy_rank_promotion", "raise")
    jax.config.update("jax_numpy_dtype_promotion", "strict")

REPOSITORY = Path(__file__).resolve().parent.parent

settings.register_profile(
    "jaxplan", deadline=None, derandomize=True, max_examples=50, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("jaxplan")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in a shell's background job; children would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def repository() -> Path:
    """The root of the source tree."""
    return REPOSITORY


@pytest.fixture(scope="session")
def examples() -> Path:
    """Third-party recordings and maps, which are not part of this repository."""
    folder = REPOSITORY.parent / "shared" / "examples"
    if not folder.is_dir():
        pytest.skip(f"the third-party example inputs are not at {folder}")
    return folder


@pytest.fixture(scope="module", autouse=True)
def forget_programs() -> Iterator[None]:
    """No module's compiled programs stay in memory after it, nor what they leave free between what is used."""
    yield
    jax.clear_caches()
    gc.collect()
    if sys.platform == "linux":
        ctypes.CDLL(None).malloc_trim(0)


@pytest.fixture
def x64() -> Iterator[None]:
    """64-bit JAX types for one test."""
    with jax.enable_x64(True):
        yield


@pytest.fixture
def compilations() -> Iterator[CompilationCounter]:
    """How many programs were compiled since the test began."""
    counter = CompilationCounter()
    jax.monitoring.register_event_duration_secs_listener(counter)
    yield counter
    jax.monitoring.unregister_event_duration_listener(counter)
