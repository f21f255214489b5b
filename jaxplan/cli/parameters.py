"""How the command line reads values, for every command alike."""

from collections.abc import Sequence
from typing import Any

from cyclopts import Parameter, Token, convert


def _convert(kind: Any, tokens: Sequence[Token]) -> Any:
    """What cyclopts does, except that 1.5 is not rounded to a whole number."""
    if kind is int:
        return int(tokens[0].value)
    return convert(kind, tokens)


DEFAULT_PARAMETER = Parameter(negative=(), converter=_convert)
SEVERAL = Parameter(negative=(), converter=_convert, consume_multiple=True)
"""The same where one flag takes several values: ``--speeds 1 3 5``."""
EVERY_TOKEN = Parameter(show=False, allow_leading_hyphen=True, negative=())
"""For a command that reads its own arguments."""
