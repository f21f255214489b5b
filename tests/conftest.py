"""Fixtures shared by all tests. Nothing here changes JAX's global settings: the library must work without."""

import signal
from collections.abc import Iterator
from pathlib import Path

import jax
import pytest
from hypothesis import HealthCheck, settings

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


@pytest.fixture
def x64() -> Iterator[None]:
    """64-bit JAX types for one test."""
    with jax.enable_x64(True):
        yield


class CompilationCounter:
    """Counts what XLA compiles; ``count`` can be set back to 0."""

    EVENT = "/jax/core/compile/backend_compile_duration"

    def __init__(self) -> None:
        self.count = 0

    def __call__(self, event: str, duration: float, **kwargs: object) -> None:
        self.count += event == self.EVENT


@pytest.fixture
def compilations() -> Iterator[CompilationCounter]:
    """How many programs were compiled since the test began."""
    counter = CompilationCounter()
    jax.monitoring.register_event_duration_secs_listener(counter)
    yield counter
    jax.monitoring.unregister_event_duration_listener(counter)
