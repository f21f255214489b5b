"""Which versions of JAX this library trusts, and what is installed.

Only package metadata is read here: asking costs no import of JAX. The versions refused are those that
were measured to hang or to compute wrong numbers (docs/decisions/0001-jax-versions.md).
"""

import platform
import re

from jaxplan.errors import UnsupportedVersion

REPORTED = ("jaxplan", "jax", "jaxlib", "flax", "numpy", "scipy", "mujoco", "mujoco-mjx", "numba")
"""The packages whose versions decide a result, in the order they are reported."""

_OLDEST_JAX = (0, 9, 2)
_KNOWN_BAD: dict[tuple[int, ...], str] = {
    (0, 10): "hangs in batched linear algebra or computes wrong numbers silently (jax#39103)",
    (0, 11): "crashes (jax#39257) or runs long scans thousands of times too slowly (jax#40101)",
}


def require_supported_jax() -> None:
    """Refuse the JAX versions known to be wrong; raises ``UnsupportedVersion``."""
    for package in ("jax", "jaxlib"):
        version = _version(package)
        complaint = _complaint(version)
        if complaint:
            raise UnsupportedVersion(
                f"{package} {version or '(not installed)'} {complaint}: jaxplan needs jax and jaxlib 0.9.2, or 0.12 or "
                "later (Python 3.12+); install with: pip install 'jax>=0.9.2,!=0.10.*,!=0.11.*'"
            )


def installed_versions() -> dict[str, str | None]:
    """The versions of Python and of the packages that decide a result; None where one is absent."""
    packages = {package: _version(package) for package in REPORTED}
    return {"python": platform.python_version(), **packages}


def _version(package: str) -> str | None:
    from importlib import metadata  # takes a tenth of a second to import

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _complaint(version: str | None) -> str:
    """Why a version of jax or jaxlib is refused; empty where it is not."""
    numbers = tuple(int(number) for number in re.findall(r"\d+", version or "")[:3])
    if len(numbers) < 2:
        return "is not a version that can be judged"
    if numbers < _OLDEST_JAX:
        return "is older than what this library was tested with"
    return _KNOWN_BAD.get(numbers[:2], "")
