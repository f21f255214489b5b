"""Finding the experiments and benchmarks, inside an installed package or beside it in the source tree."""

import functools
import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from jaxplan.errors import InputError, ResourceError
from jaxplan.names import meant
from jaxplan.runner.definition import Experiment

_PACKAGE = Path(__file__).parent.parent


def bundled(folder: str, module: str = "") -> ModuleType:
    """A module of the source tree's ``folder``, which a wheel carries as ``jaxplan/_<folder>``."""
    if (_PACKAGE / f"_{folder}").is_dir():
        return importlib.import_module(f"jaxplan._{folder}.{module}".rstrip("."))
    source = _PACKAGE.parent
    if not (source / folder / "__init__.py").is_file():
        raise ResourceError(f"this installation has no {folder}; install a wheel or use the source tree")
    if str(source) not in sys.path:
        sys.path.insert(0, str(source))
    return importlib.import_module(f"{folder}.{module}".rstrip("."))


def experiment_names() -> tuple[str, ...]:
    """Names of the stored experiments, in the order of the paper."""
    return tuple(summaries())


def summaries() -> dict[str, str]:
    """What each of the stored experiments shows, by name; none of them is imported for it."""
    return bundled("experiments").SUMMARIES


@functools.cache
def load_experiment(name: str) -> Experiment[Any]:
    """The experiment called ``name``: a stored one, or the ``EXPERIMENT`` of one's own module, ``package.module``.

    Raises:
        InputError: neither.
    """
    names = experiment_names()
    if "." in name:
        try:
            return importlib.import_module(name).EXPERIMENT
        except (ImportError, AttributeError, ValueError, TypeError) as error:
            raise InputError(f"experiment: {name!r} is no module with an EXPERIMENT ({error}); correct it") from error
    if name not in names:
        raise InputError(
            f"experiment: unknown name {name!r}, want one of {', '.join(names)}, or your own package.module"
            f"{meant(name, names)}"
        )
    return bundled("experiments", name.replace("-", "_")).EXPERIMENT
