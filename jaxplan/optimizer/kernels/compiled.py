"""How the descent is compiled; anew whenever a file has changed of this folder or of those whose functions it calls."""

from pathlib import Path

from jaxplan.native import digest_of, entry_point, inner, summing, within
from jaxplan.search.kernels import compiled as of_search
from jaxplan.tracking.kernels import compiled as of_tracking

__all__ = ["entry_point", "inner", "source_digest", "summing", "within"]


def source_digest() -> str:
    """Hash of all source files."""
    return digest_of(Path(__file__).parent) + of_search.source_digest() + of_tracking.source_digest()
