"""The ``jaxplan`` command.

Exit codes: 0 a valid run whatever its outcome, 2 usage, 10 bad input, 11 bad file, 12 resource, 13 no interception
although one was required, 70 internal, 130 and 143 interrupted. An error is one line on stderr.
"""

import contextlib
import dataclasses
import importlib
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

from cyclopts import App, CycloptsError, Parameter, Token, convert

from jaxplan.config import InterceptConfig
from jaxplan.errors import JaxplanError, ResourceError
from jaxplan.versions import require_supported_jax

if TYPE_CHECKING:
    from jaxplan.interception import Episode
    from jaxplan.io.output import OutputFolder

EXIT_USAGE = 2
EXIT_NOT_INTERCEPTED = 13
EXIT_INTERNAL = 70
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143
EXIT_PIPE_CLOSED = 141

Progress = Callable[[str, float], None]
"""Called with what is being done and the share of the longest possible episode that is over."""


def _convert(kind: Any, tokens: Sequence[Token]) -> Any:
    """What cyclopts does, except that 1.5 is not rounded to a whole number."""
    if kind is int:
        return int(tokens[0].value)
    return convert(kind, tokens)


app = App(
    name="jaxplan",
    help="Plan and fly interceptions of a moving target by a quadrotor, among obstacles.",
    version=lambda: metadata.version("jaxplan"),
    default_parameter=Parameter(negative=(), converter=_convert),
    suppress_keyboard_interrupt=False,
)


@app.command
def intercept(
    config: Annotated[InterceptConfig | None, Parameter(name="*")] = None,
    *,
    require_success: bool = False,
    debug: bool = False,
) -> int:
    """Fly one closed-loop interception and write its numbers, trajectories, plans and picture.

    Parameters
    ----------
    require_success
        Return exit code 13 unless the target was intercepted.
    debug
        Show the traceback of an error.
    """
    config = config or InterceptConfig()
    require_supported_jax()
    from jaxplan import interception
    from jaxplan.io.output import OutputFolder
    from jaxplan.metrics import episode_metrics

    with OutputFolder(config.out) as folder:
        with _progress_bar() as progress:
            episode = interception.run(config, progress=progress)
        metrics = episode_metrics(episode)
        write_results(folder, config, episode, metrics)
        folder.publish()
    for warning in metrics["target"]["warnings"]:
        print(f"jaxplan: warning: target: {warning}", file=sys.stderr)
    print(summary(metrics))
    print(f"results in {config.out}: {', '.join(sorted(path.name for path in Path(config.out).iterdir()))}")
    return EXIT_NOT_INTERCEPTED if require_success and not episode.success else 0


@app.command
def world(file: str, *, padding: float = 0.5, out: str = "world.png", debug: bool = False) -> int:
    """Read a map, say what was read, and draw it.

    Parameters
    ----------
    file
        A stored world's name (env1, env2, env3) or a file: .xml .stl .obj .ply .pcd .npy .npz .bt .json.
    padding
        Distance [m] that paths keep from obstacles.
    out
        Where the picture is saved.
    debug
        Show the traceback of an error.
    """
    import numpy as np

    from jaxplan.errors import InputError
    from jaxplan.io.targets import load_target, stored_targets
    from jaxplan.viz.world import draw_world_picture
    from jaxplan.world.report import lattice_reports, obstacle_counts
    from jaxplan.world.scene import load_world

    if not Path(out).parent.is_dir() or Path(out).suffix != ".png":
        raise InputError(f"--out: have {out!r}, want a .png file in a folder that exists; correct it")
    read = load_world(file)
    size = " x ".join(f"{side:.4g}" for side in read.bounds[1] - read.bounds[0])
    print(f"{read.provenance}\nextent    {size} m, from {read.bounds[0].tolist()} to {read.bounds[1].tolist()}")
    print("obstacles " + (", ".join(f"{count} {kind}" for kind, count in obstacle_counts(read).items()) or "none"))
    print(f"{'lattice':>9} {'cells':>10} {'occupied':>9} {'largest free part':>18} {'parts':>6}")
    for row in lattice_reports(read, padding=padding):
        cells = f"{row.resolution:>7g} m {row.cells:>10} {row.occupied:>9.1%} {row.largest:>18.1%} {row.parts:>6}"
        print(cells)
    targets = [load_target(name, world=file) for name in stored_targets(file)]
    curves = {target.name: target.position(np.linspace(0.0, target.duration, 400)) for target in targets}
    draw_world_picture(read, Path(out), curves)
    print(f"picture   {out}")
    return 0


@app.command
def bench(name: Literal["minsnap", "time-allocation"], *, json: str | None = None, debug: bool = False) -> int:
    """Measure a station against its peers, in one run on this machine.

    Parameters
    ----------
    name
        What to measure.
    json
        Where the rows are saved, with hardware, versions and commit.
    debug
        Show the traceback of an error.
    """
    require_supported_jax()
    _benchmark(name).main([] if json is None else ["--json", json])
    return 0


def _benchmark(name: str) -> Any:
    """The benchmark's module: inside an installed package, or beside the package in the source tree."""
    module = f"bench_{name.replace('-', '_')}"
    if (Path(__file__).parent / "_benchmarks").is_dir():
        return importlib.import_module(f"jaxplan._benchmarks.{module}")
    source = Path(__file__).parent.parent
    if not (source / "benchmarks" / f"{module}.py").is_file():
        raise ResourceError("bench: this installation has no benchmarks; install a wheel or use the source tree")
    if str(source) not in sys.path:
        sys.path.insert(0, str(source))
    return importlib.import_module(f"benchmarks.{module}")


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and leave the process with its exit code."""
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def run(arguments: Sequence[str]) -> int:
    """Run the command line; every failure becomes one line on stderr and an exit code."""
    signal.signal(signal.SIGTERM, _terminate)
    try:
        code = app(list(arguments), exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except CycloptsError as error:
        cause = _library_error(error)
        if cause is not None:
            return _report(str(cause), cause.exit_code, arguments)
        return _report(f"{str(error).rstrip('.')}; see: jaxplan intercept --help", EXIT_USAGE, arguments)
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


def write_results(folder: "OutputFolder", config: InterceptConfig, episode: "Episode", metrics: dict[str, Any]) -> None:
    """Stage all files of one episode; metrics.json is the last, so its presence vouches for the others."""
    import numpy as np

    from jaxplan.io.files import write_json, write_tum
    from jaxplan.io.plans import write_plans
    from jaxplan.viz.episode import draw_episode

    flight = episode.flight
    times = flight.times
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 1))  # a target's attitude is not modelled
    folder.write("config.json", lambda path: write_json(path, dataclasses.asdict(config)))
    folder.write("flown.csv", lambda path: write_tum(path, times, flight.position, flight.quat_wxyz))
    folder.write("target.csv", lambda path: write_tum(path, times, flight.target, upright))
    folder.write("plans.npz", lambda path: write_plans(path, episode.plans))
    folder.write("episode.png", lambda path: draw_episode(episode, metrics, path))
    folder.write("metrics.json", lambda path: write_json(path, metrics))


def summary(metrics: dict[str, Any]) -> str:
    """A short table of one episode's numbers."""
    rows = [
        ("outcome", metrics["outcome"], ""),
        ("time to intercept", _number(metrics["time_to_intercept_s"]), "s"),
        ("smallest distance", _number(metrics["min_distance_m"]), "m"),
        ("largest position error", _number(metrics["max_position_error_m"]), "m"),
        ("largest yaw error", _number(metrics["max_yaw_error_deg"]), "deg"),
        ("smallest clearance", _number(metrics["min_clearance_m"]), "m"),
        ("replans", metrics["replans"], ""),
    ]
    for stage, quantiles in metrics["replan_ms"].items():
        if isinstance(quantiles, dict) and "p50" in quantiles:
            values = f"{_number(quantiles['p50'], 1)} / {_number(quantiles['p99'], 1)}"
            rows.append((f"replan {stage}, p50 / p99", values, "ms"))
    widths = [max(len(str(row[column])) for row in rows) for column in range(2)]
    return "\n".join(f"{name:<{widths[0]}}  {value!s:>{widths[1]}} {unit}".rstrip() for name, value, unit in rows)


def _number(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


@contextlib.contextmanager
def _progress_bar() -> Iterator[Progress]:
    """A bar on stderr, where that is a terminal."""
    from tqdm import tqdm

    layout = "{desc} {bar} {elapsed}"
    with tqdm(desc="loading", total=1.0, file=sys.stderr, disable=None, leave=False, bar_format=layout) as bar:

        def progress(text: str, share: float) -> None:
            bar.set_description_str(text, refresh=False)
            bar.n = min(share, 1.0)
            bar.refresh()

        yield progress


def _library_error(error: BaseException) -> JaxplanError | None:
    """The error of this library that the argument parser wrapped, if any."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, JaxplanError):
        cause = cause.__cause__ or cause.__context__
    return cause


def _report(text: str, code: int, arguments: Sequence[str]) -> int:
    if "--debug" in arguments:
        traceback.print_exc()
    print(f"jaxplan: {' '.join(text.split())}", file=sys.stderr)
    return code


def _terminate(signum: int, frame: object) -> NoReturn:
    """Leave through the context managers, so that nothing half-written stays."""
    raise SystemExit(EXIT_TERMINATED)


if __name__ == "__main__":
    main()
