"""Typed exceptions, raised only at the host border.

Every message is one sentence that says what is wrong, where, what was found, what is wanted and what to
do. Inside compiled code failures are reason bits instead (``jaxplan.status``).
"""


class JaxplanError(Exception):
    """Base of everything that jaxplan raises on purpose; ``exit_code`` is what the command line returns."""

    exit_code = 70


class InputError(JaxplanError, ValueError):
    """An argument, a start, a target or a configuration value cannot be used."""

    exit_code = 10


class FileError(JaxplanError, ValueError):
    """A file is missing, unreadable or not what it claims to be."""

    exit_code = 11


class ResourceError(JaxplanError, RuntimeError):
    """The machine cannot do it: a disk that is full, a folder that is read-only, a device that is absent."""

    exit_code = 12


class UnsupportedVersion(ResourceError, ImportError):
    """An installed package is known to hang or to compute wrong numbers."""


class IncompleteError(JaxplanError, RuntimeError):
    """Some items of an experiment failed, and what was asked for cannot be made without them."""

    exit_code = 14


class InternalError(JaxplanError, RuntimeError):
    """A promise that the library makes to itself was broken: please report it."""

    exit_code = 70
