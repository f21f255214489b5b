"""``jaxplan experiment``: the paper's tables and figures, each by one command."""

import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import cyclopts.config
from cyclopts import App, Parameter

from jaxplan.cli.cache import use_cache
from jaxplan.cli.parameters import EVERY_TOKEN, SEVERAL
from jaxplan.errors import IncompleteError, InputError
from jaxplan.names import meant
from jaxplan.versions import require_supported_jax

if TYPE_CHECKING:
    from jaxplan.runner.definition import Experiment
    from jaxplan.runner.run import Progress

EXIT_QUARANTINED = IncompleteError.exit_code
PRESETS = ("smoke", "small", "full")
USAGE = "jaxplan experiment NAME --preset smoke|small|full [--workers N | --scheduler ADDRESS] [--out DIR] [--resume]"


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """How a run is carried out."""

    preset: str | None = None
    """smoke (minutes or less), small or full. Default: smoke. Every further flag changes one of its fields."""

    config: Path | None = None
    """A config.json that an earlier run wrote, instead of a preset."""

    workers: int | None = None
    """Processes on this machine; 0: only this one. Default: one for each core."""

    scheduler: str | None = None
    """Address of a dask scheduler with workers of its own, like tcp://host:8786."""

    out: Path | None = None
    """Folder for the results. Default: out/NAME."""

    resume: bool = False
    """Go on with what the folder holds, with its configuration unless a preset is given."""

    debug: bool = False
    """Show the traceback of an error."""


def experiment(*tokens: Annotated[str, EVERY_TOKEN]) -> int:
    """Reproduce a table or a figure: jaxplan experiment NAME --preset smoke|small|full; --list says which there are."""
    require_supported_jax()
    from jaxplan.runner.registry import load_experiment, summaries

    if not tokens or tokens[0] in {"--list", "--help", "-h"}:
        print(f"Usage: {USAGE}\n\nFlags of one: jaxplan experiment NAME --help\n")
        width = max(map(len, summaries()))
        for name, summary in summaries().items():
            print(f"  {name:<{width}}  {summary}")
        return 0
    name, rest = tokens[0], list(tokens[1:])
    if name.startswith("-"):
        raise InputError(f"experiment: have {name!r} first, want a name; see: jaxplan experiment --list")
    if "--preset" in rest[:-1] and (preset := rest[rest.index("--preset") + 1]) not in PRESETS:
        raise _no_preset(preset)  # before the experiment is imported
    use_cache()
    found = load_experiment(name)
    options = _options_of(found, name, rest)
    if options is None:
        return 0
    preset, base = _base(found, name, options)
    app = _app(found, name, base)
    config, options = app(rest, exit_on_error=False, print_error=False, result_action="return_value")
    return _run(name, preset, config, options)


def _app(found: "Experiment[Any]", name: str, base: dict[str, Any]) -> App:
    """An app whose command returns its own arguments; fields that are not given are those of ``base``."""
    kind, first = found.config_type, found.presets["smoke"]

    def take(config: Any = None, options: Any = None) -> tuple[Any, RunOptions]:
        return config or first, options or RunOptions()

    take.__annotations__ = {
        "config": Annotated[kind | None, Parameter(name="*")],
        "options": Annotated[RunOptions | None, Parameter(name="*")],
    }
    app = App(
        name=f"jaxplan experiment {name}",
        help=found.summary,
        version_flags=[],
        default_parameter=SEVERAL,
        config=cyclopts.config.Dict({key: value for key, value in base.items() if value is not None}),
    )
    app.default(take)
    return app


def _options_of(found: "Experiment[Any]", name: str, tokens: list[str]) -> RunOptions | None:
    """The run's options alone; None where help was asked for and shown."""
    from jaxplan.runner.configuration import as_plain

    app = _app(found, name, as_plain(found.presets["smoke"]))
    result = app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
    return None if result is None else result[1]


def _base(found: "Experiment[Any]", name: str, options: RunOptions) -> tuple[str, dict[str, Any]]:
    """Preset and fields to begin with: of a file, of a preset, or of the run that is resumed."""
    from jaxplan.runner.configuration import as_plain, from_plain, read_config

    if options.preset is not None and options.config is not None:
        raise InputError("--preset and --config: have both, want one of them")
    if options.preset is not None and options.preset not in PRESETS:
        raise _no_preset(options.preset)
    saved = options.config or _folder(name, options) / "config.json"
    if options.config is not None or (options.preset is None and options.resume and os.path.isfile(saved)):
        preset, values = read_config(saved, name)
        from_plain(found.config_type, values)
        return preset, values
    preset = options.preset or "smoke"
    return preset, as_plain(found.presets[preset])


def _no_preset(have: str) -> InputError:
    return InputError(f"--preset: have {have!r}, want one of {', '.join(PRESETS)}{meant(have, PRESETS)}")


def _folder(name: str, options: RunOptions) -> Path:
    return options.out or Path("out") / name


def _run(name: str, preset: str, config: Any, options: RunOptions) -> int:
    from jaxplan.runner.run import Request, run

    folder = _folder(name, options)
    request = Request(
        name=name,
        config=config,
        out=folder,
        preset=preset,
        workers=options.workers,
        scheduler=options.scheduler,
        resume=options.resume,
        command=("jaxplan", *sys.argv[1:]) if sys.argv[1:2] == ["experiment"] else (),
    )
    try:
        done = run(request, _progress())
    except KeyboardInterrupt:
        print(f"jaxplan: stopped; go on with: jaxplan experiment {name} --out {folder} --resume", file=sys.stderr)
        raise
    print(done.report.summary)
    print(f"report in {folder / 'report.md'}")
    for item, why in done.quarantined.items():
        print(f"jaxplan: quarantined {item}: {' '.join(why.split())}", file=sys.stderr)
    return EXIT_QUARANTINED if done.quarantined else 0


def _progress() -> "Progress":
    """Prints how far a run is: in place on a terminal, else a line every ten seconds."""
    last = [-10.0]

    def tell(text: str) -> None:
        if sys.stderr.isatty():
            print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)
        elif time.monotonic() - last[0] >= 10.0:
            last[0] = time.monotonic()
            print(text, file=sys.stderr, flush=True)

    return tell
