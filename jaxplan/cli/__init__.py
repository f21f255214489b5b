"""The ``jaxplan`` command.

Exit codes: 0 a valid run whatever its outcome, 2 usage, 10 bad input, 11 bad file, 12 resource, 13 no interception
although one was required, 14 an experiment left something out, 70 internal, 130 and 143 interrupted. An error is one
line on stderr.
"""

import os
import signal
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

from cyclopts import App, CycloptsError

import jaxplan
from jaxplan.cli.bench import bench
from jaxplan.cli.cache import cache
from jaxplan.cli.experiment import experiment
from jaxplan.cli.export import export
from jaxplan.cli.intercept import from_saved, intercept
from jaxplan.cli.parameters import DEFAULT_PARAMETER
from jaxplan.cli.stream import stream
from jaxplan.cli.train import train, unknown_trainer
from jaxplan.cli.vehicle import vehicle
from jaxplan.cli.view import view
from jaxplan.cli.world import world
from jaxplan.errors import JaxplanError
from jaxplan.names import meant

EXIT_USAGE = 2
EXIT_INTERNAL = 70
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143
EXIT_PIPE_CLOSED = 141

WELCOME = """\
Plan and fly interceptions of a moving target by a quadrotor, among obstacles.

First:  jaxplan intercept                   fly one: numbers, trajectories and a picture in out/intercept
Then:   jaxplan intercept --target env1-03 --speed 2.5 --predictor gmm
        jaxplan intercept --world room.stl --target flight.csv
        jaxplan vehicle racer5              what a vehicle can do; your own takes three lines
        jaxplan experiment --list           the paper's tables and figures
Sooner: the first start compiles, later ones load what was compiled: jaxplan cache
All:    jaxplan --help, jaxplan COMMAND --help"""


def _version() -> str:
    return jaxplan.__version__


app = App(
    name="jaxplan",
    help="Plan and fly interceptions of a moving target by a quadrotor, among obstacles.",
    version=_version,
    default_parameter=DEFAULT_PARAMETER,
    suppress_keyboard_interrupt=False,
    help_format="plaintext",
)
app.command(intercept, config=from_saved)
for command in (export, view, stream, world, vehicle, bench, train):
    app.command(command)
app.command(cache)
app.command(experiment, help_flags=[], version_flags=[])
app.register_install_completion_command(help="Complete commands and options in this shell (bash, zsh, fish).")


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave the process with its exit code."""
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: Sequence[str]) -> int:
    """Run the command line; every failure becomes one line on stderr and an exit code."""
    signal.signal(signal.SIGTERM, _terminate)
    if not arguments:
        print(WELCOME)
        return 0
    unknown = unknown_trainer(arguments[1:]) if arguments[0] == "train" else _unknown_command(arguments[0])
    if unknown is not None:
        return _report(unknown, EXIT_USAGE, arguments)
    try:
        code = app(list(arguments), exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except CycloptsError as error:
        cause = _library_error(error)
        if cause is not None:
            return _report(str(cause), cause.exit_code, arguments)
        command = "" if arguments[0].startswith("-") else f" {arguments[0]}"
        return _report(f"{str(error).rstrip('.')}; see: jaxplan{command} --help", EXIT_USAGE, arguments)
    except JaxplanError as error:
        return _report(str(error), error.exit_code, arguments)
    except KeyboardInterrupt:
        return _report("interrupted", EXIT_INTERRUPTED, arguments)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PIPE_CLOSED
    except Exception as error:
        text = f"internal error: {type(error).__name__}: {error}; please report it with the output of --debug"
        return _report(text, EXIT_INTERNAL, arguments)


def _unknown_command(name: str) -> str | None:
    """What is wrong where it is none of the commands, nor an option that stands alone."""
    if name in app:
        return None
    commands = [command for command in app if not command.startswith("-")]
    return f"there is no command {name!r}: want one of {', '.join(commands)}{meant(name, commands)}"


def _library_error(error: BaseException) -> JaxplanError | None:
    """The error of this library that the argument parser wrapped, if any."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, JaxplanError):
        cause = cause.__cause__ or cause.__context__
    return cause


def _report(text: str, code: int, arguments: Sequence[str]) -> int:
    if "--debug" in arguments and sys.exception() is not None:
        traceback.print_exc()
    print(f"jaxplan: {' '.join(text.split())}", file=sys.stderr)
    return code


def _terminate(signum: int, frame: object) -> NoReturn:
    """Leave through the context managers, so that nothing half-written stays."""
    raise SystemExit(EXIT_TERMINATED)
