"""How the command line reads values, for every command alike, and how it makes options of configurations."""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Protocol, get_type_hints, runtime_checkable

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
_BESIDE = Parameter(name="*")
_FIXED = Parameter(parse=False)


@runtime_checkable
class Command(Protocol):
    """A command of the line: gets its options by name and returns an exit code."""

    def __call__(self, *tokens: Any, **options: Any) -> int:
        """Run the command."""
        ...


def with_options(kind: type, *, beside: Sequence[str] = (), fixed: Sequence[str] = ()) -> Callable[[Command], Command]:
    """A decorator: every field of the dataclass ``kind`` is an option of the command, which gets it as ``config``.

    Names, defaults and help are the fields' own, so that no option is written twice.

    Args:
        beside: fields that are configurations themselves and whose fields are options like the others, ``--excess``
            instead of ``--imitation.excess``.
        fixed: fields that cannot be chosen.
    """
    hints = get_type_hints(kind, include_extras=True)
    marked = [(name, Annotated[hints[name], _BESIDE]) for name in beside]
    marked += [(name, Annotated[hints[name], _FIXED]) for name in fixed]
    defaults = {field.name: field.default for field in dataclasses.fields(kind)}
    fields = [(name, hint, defaults[name]) for name, hint in marked]
    namespace = {"__module__": kind.__module__}
    options = dataclasses.make_dataclass(kind.__name__, fields, bases=(kind,), namespace=namespace, frozen=True)

    def decorate(command: Command) -> Command:
        @functools.wraps(command)
        def called(*, config: Any = None, **given: Any) -> int:
            chosen = options() if config is None else config
            return command(config=kind(**{name: getattr(chosen, name) for name in defaults}), **given)

        signature = inspect.signature(command)
        parameters = signature.parameters | {"config": signature.parameters["config"].replace(default=None)}
        called.__signature__ = signature.replace(parameters=list(parameters.values()))  # type: ignore[attr-defined]
        called.__annotations__ = command.__annotations__ | {"config": Annotated[options | None, _BESIDE]}
        return called

    return decorate


def command_line(command: str, *parts: Mapping[str, Any]) -> str:
    """The line that gives these options; those that are None are left out."""
    options = {name: value for part in parts for name, value in part.items() if value is not None}
    words = [f"--{name.replace('_', '-')} {_spelled(value)}" for name, value in options.items()]
    return " ".join(["jaxplan", command, *words])


def option_values(config: Any, beside: Sequence[str] = (), fixed: Sequence[str] = ()) -> dict[str, Any]:
    """The values of the options that ``with_options`` makes of a configuration, by the names of the fields."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if field.name in beside:
            found |= option_values(value)
        elif field.name not in fixed:
            found[field.name] = value
    return found


def _spelled(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)
