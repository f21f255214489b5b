"""``jaxplan intercept``: one closed-loop episode, its files and its table."""

import dataclasses
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import cyclopts.config
from cyclopts import App, ArgumentCollection, Parameter

from jaxplan.cli.cache import use_cache
from jaxplan.cli.progress import progress_bar
from jaxplan.config import InterceptConfig
from jaxplan.errors import FileError, InputError
from jaxplan.names import require_target, require_vehicle, require_weights, require_world, stored_targets
from jaxplan.versions import require_supported_jax

if TYPE_CHECKING:
    from jaxplan.interception import Episode
    from jaxplan.io.output import OutputFolder

EXIT_NOT_INTERCEPTED = 13


def intercept(
    config: Annotated[InterceptConfig | None, Parameter(name="*")] = None,
    *,
    repeat: Annotated[Path | None, Parameter(name="--config")] = None,
    overwrite: bool = False,
    require_success: bool = False,
    realtime: bool = False,
    debug: bool = False,
) -> int:
    """Fly one closed-loop interception and write its numbers, trajectories, plans and picture.

    Parameters
    ----------
    repeat
        A config.json that an earlier run wrote: its options, but for the folder, where none are given.
    overwrite
        Replace the run that a folder given by --out holds; out/intercept is replaced without.
    require_success
        Return exit code 13 unless the target was intercepted.
    realtime
        Fly against the clock on the wall, with the planner in a process of its own.
    debug
        Show the traceback of an error.
    """
    config = config or InterceptConfig()
    get_ready(config, overwrite)
    from jaxplan.io.output import OutputFolder

    with OutputFolder(config.out) as folder:
        with progress_bar("flight" if not realtime else "realtime") as progress:
            from jaxplan import interception  # takes seconds

            fly = interception.run_in_real_time if realtime else interception.run
            episode = fly(config, progress=progress)
        from jaxplan.metrics import episode_metrics

        metrics = episode_metrics(episode)
        write_results(folder, config, episode, metrics)
        folder.publish()
    for what in ("target", "vehicle"):
        for warning in metrics[what]["warnings"]:
            print(f"jaxplan: warning: {what}: {warning}", file=sys.stderr)
    if metrics["target"].get("read_as"):
        print(f"target read from {metrics['target']['read_as']}")
    print(summary(metrics))
    print(f"results in {config.out}: {', '.join(sorted(path.name for path in Path(config.out).iterdir()))}")
    return EXIT_NOT_INTERCEPTED if require_success and not episode.success else 0


def get_ready(config: InterceptConfig, overwrite: bool) -> None:
    """What comes before anything slow is imported: refuse what cannot work, and use the cache of compiled programs.

    Raises:
        InputError, FileError: a name is unknown, or the folder holds a run. ResourceError: JAX is a version that fails.
    """
    require_supported_jax()
    _require_names(config)
    _require_no_run(Path(config.out), overwrite)
    use_cache()


def _require_names(config: InterceptConfig) -> None:
    """Raise what the loaders would raise for names that there are not, before anything slow is imported."""
    require_world(config.world)
    require_vehicle(config.vehicle)
    if config.target is not None or stored_targets(config.world):  # else the world's file is read first
        require_target(config.target, config.world)
    learned = (("policy", config.policy), ("placing policy", config.placing), ("classifier", config.classifier))
    for kind, source in learned:
        if source is not None:
            require_weights(source, kind)


def _require_no_run(out: Path, overwrite: bool) -> None:
    """Raise ``InputError`` where a folder of one's own holds a run already."""
    if not overwrite and str(out) != InterceptConfig.out and os.path.isfile(out / "metrics.json"):
        raise InputError(f"--out: {str(out)!r} holds a run already; choose another folder or give --overwrite")


def from_saved(app: App, commands: tuple[str, ...], arguments: ArgumentCollection) -> None:
    """Give options that are not on the command line the values of the file behind ``--config``, if there is one."""
    saved = next((argument.tokens for argument in arguments if argument.name == "--config"), [])
    if saved:
        values = _read_saved(Path(saved[0].value))
        as_text = {name.replace("_", "-"): value for name, value in values.items()}
        cyclopts.config.Dict({commands[-1]: as_text})(app, commands, arguments)


def _read_saved(path: Path) -> dict[str, Any]:
    """The options in a ``config.json`` that have a value; ``FileError``, ``InputError`` where it is none."""
    try:
        saved = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise FileError(f"{path}: cannot be read as a config.json ({error}); give one that a run wrote") from error
    known = [field.name for field in dataclasses.fields(InterceptConfig)]
    if not isinstance(saved, dict) or not set(saved) <= set(known):
        raise InputError(f"{path}: is not of jaxplan intercept, want some of {', '.join(known)}; choose another file")
    try:
        InterceptConfig(**saved)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return {name: value for name, value in saved.items() if value is not None and name != "out"}


def write_results(folder: "OutputFolder", config: InterceptConfig, episode: "Episode", metrics: dict[str, Any]) -> None:
    """Stage all files of one episode; metrics.json is the last, so its presence vouches for the others."""
    import numpy as np

    from jaxplan.io.cycles import saved_cycles, write_cycles
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
    cycles = saved_cycles(episode.cycles, episode.observations, episode.plans, episode.scenario.predictor)
    folder.write("cycles.npz", lambda path: write_cycles(path, cycles))
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
    if metrics["real_time"] is not None:
        kept = metrics["real_time"]
        rows.append(
            ("setpoint, p50 / p99", f"{kept['setpoint_us']['p50']:.0f} / {kept['setpoint_us']['p99']:.0f}", "us")
        )
        rows.append(("late plans", kept["late_plans"], ""))
    widths = [max(len(str(row[column])) for row in rows) for column in range(2)]
    return "\n".join(f"{name:<{widths[0]}}  {value!s:>{widths[1]}} {unit}".rstrip() for name, value, unit in rows)


def _number(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
