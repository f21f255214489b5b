"""``jaxplan view``: an interception to look at, in a browser, as a page or as an animation."""

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from jaxplan.config import InterceptConfig

if TYPE_CHECKING:
    from jaxplan.interception import Episode
    from jaxplan.viz.replay import Replay
    from jaxplan.viz.viewer import Viewer

PATIENCE = 60.0
"""Seconds for which a live flight waits for somebody to look."""


def view(
    source: Path | None = None,
    *,
    config: Annotated[InterceptConfig | None, Parameter(name="*", group="Of the flight, with --live")] = None,
    live: bool = False,
    overwrite: bool = False,
    port: int = 8080,
    html: Path | None = None,
    gif: Path | None = None,
    mp4: Path | None = None,
    debug: bool = False,
) -> int:
    """Look at an interception: in a browser until Ctrl-C, or written into a file.

    Parameters
    ----------
    source
        The folder of an interception, or a plans.npz.
    live
        Fly an interception now, with the options of jaxplan intercept, and look at it meanwhile.
    overwrite
        Replace the run that a folder given by --out holds, with --live.
    port
        Of the viewer on this machine.
    html
        Write one page that needs nothing else instead.
    gif
        Write an animation instead.
    mp4
        Write a video instead, with ffmpeg.
    debug
        Show the traceback of an error.
    """
    from jaxplan.errors import InputError

    files = {ending: path for ending, path in ((".html", html), (".gif", gif), (".mp4", mp4)) if path is not None}
    if live == (source is not None):
        raise InputError("view: want the folder of an interception, or its plans.npz, or --live; give one of them")
    if live and files:
        raise InputError(f"--live: writes no {'--' + next(iter(files))[1:]}; look at its --out afterwards")
    if source is None:
        return _fly(config or InterceptConfig(), port, overwrite)
    if config is not None:
        raise InputError("view: the options of an interception need --live; without it leave them out")
    _require_places(files)
    from jaxplan.viz.replay import read_replay

    replay = read_replay(source)
    for ending, path in files.items():
        _write(replay, ending, path)
    if not files:
        from jaxplan.viz.viewer import Viewer

        _serve(Viewer(replay, port))
    return 0


def _require_places(files: dict[str, Path]) -> None:
    """Raise ``InputError`` for files that cannot be what they are to be, before anything is drawn."""
    from jaxplan.errors import InputError

    for ending, path in files.items():
        if path.suffix != ending or not os.path.isdir(path.parent):
            raise InputError(f"--{ending[1:]}: have {str(path)!r}, want a {ending} file in a folder that exists")


def _write(replay: "Replay", ending: str, path: Path) -> None:
    from jaxplan.files import Writer, cannot_write, write_atomically
    from jaxplan.viz.animation import animate
    from jaxplan.viz.html import replay_page

    def draw(staged: Path) -> None:
        animate(replay, staged)

    content: str | Writer = replay_page(replay) if ending == ".html" else draw
    try:
        write_atomically(path, content)
    except OSError as error:
        raise cannot_write(path, error) from error
    print(f"{path}: {os.path.getsize(path) / 1e6:.2f} MB")


def _serve(viewer: "Viewer") -> None:
    """Until Ctrl-C, which is how one leaves."""
    print(f"{viewer.url}: open it in a browser on this machine; Ctrl-C ends", flush=True)
    try:
        viewer.serve()
    except KeyboardInterrupt:
        print()
    finally:
        viewer.stop()


def _fly(config: InterceptConfig, port: int, overwrite: bool) -> int:
    """Fly before the viewer's eyes, no faster than the clock, and write the results as ``jaxplan intercept`` does."""
    from jaxplan.cli.intercept import get_ready, summary, write_results
    from jaxplan.cli.progress import progress_bar

    get_ready(config, overwrite)
    from jaxplan import interception
    from jaxplan.io.output import OutputFolder
    from jaxplan.metrics import episode_metrics
    from jaxplan.scenario import build_scenario
    from jaxplan.viz.replay import replay_before, replay_of
    from jaxplan.viz.viewer import Viewer

    with OutputFolder(config.out) as folder:
        began = time.perf_counter()
        scenario = build_scenario(config)
        viewer = Viewer(replay_before(scenario), port)
        print(f"{viewer.url}: open it in a browser on this machine", flush=True)
        try:
            with progress_bar("flight") as progress:
                progress("compiling", 0.0)
                interception.warm_up(scenario)
                warmup_s = time.perf_counter() - began
                progress("waiting for somebody to look", 0.0)
                viewer.wait(PATIENCE)
                took_off = time.perf_counter()

                def follow(so_far: "Episode") -> None:
                    viewer.show(replay_of(so_far, viewer.replay))
                    time.sleep(max(float(so_far.flight.times[-1]) - (time.perf_counter() - took_off), 0.0))

                episode = interception.fly(scenario, progress, follow=follow, warmup_s=warmup_s)
            metrics = episode_metrics(episode)
            write_results(folder, config, episode, metrics)
            folder.publish()
        except BaseException:
            viewer.stop()
            raise
    print(summary(metrics))
    print(f"results in {config.out}")
    _serve(viewer)
    return 0
