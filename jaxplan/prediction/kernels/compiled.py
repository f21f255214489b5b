"""How they are compiled; anew whenever a file of this folder has changed."""

from pathlib import Path

from jaxplan.native import digest_of, entry_point, inner

__all__ = ["entry_point", "inner", "source_digest"]


def source_digest() -> str:
    """Hash of all source files."""
    return digest_of(Path(__file__).parent)
