"""How far a run is, on a terminal: a bar that moves while programs are compiled, what is compiled, how long is left.

How long is left is what the last run on this machine took, or where there was none, what one on two cores takes
(``USUAL``). The share that is done is that of the programs' seconds in the last run.
"""

import contextlib
import json
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from tqdm import tqdm

    from jaxplan.compilation import Watch
    from jaxplan.interception import Progress

_WORDS = {
    "optimised": "refinement",
    "match": "times",
    "solve": "trajectories",
    "clear": "clearance",
    "route": "waypoints",
    "reject": "goals",
    "fly": "vehicle",
    "allocate": "policy",
    "predict_motion": "classifier",
}
"""What the programs are for, by the names of their functions."""
_INTERVAL = 0.2
"""Seconds between two looks."""
_FORMAT = 1


class Expected(NamedTuple):
    """What compiling takes."""

    seconds: float
    """Wall time from the first program to the last."""
    programs: dict[str, list[float]]
    """How many programs of each function there are, and how many seconds XLA takes for them."""

    def share(self, ended: dict[str, int]) -> float:
        """Which share of all is done when so many programs of each function are."""
        whole = sum(seconds for _, seconds in self.programs.values())
        done = sum(
            seconds * min(ended.get(name, 0) / max(count, 1.0), 1.0) for name, (count, seconds) in self.programs.items()
        )
        return done / whole if whole > 0.0 else 0.0


USUAL = Expected(
    25.0,
    {
        "optimised": [1, 14.0],
        "solve": [2, 9.0],
        "match": [4, 8.5],
        "clear": [4, 3.0],
        "allocate": [1, 1.8],
        "fly": [1, 2.5],
        "route": [1, 1.2],
    },
)
"""On two idle cores, nothing kept: XLA's seconds are measured, the wall time is half of all processor time."""


@contextlib.contextmanager
def progress_bar(kind: str) -> Iterator["Progress"]:
    """A bar on stderr, where that is a terminal; the next run of this ``kind`` remembers how long compiling took."""
    from tqdm import tqdm

    from jaxplan.compilation import Watch

    layout = "{desc} {bar} {elapsed}"
    with tqdm(total=1.0, file=sys.stderr, disable=None, leave=False, bar_format=layout) as bar, Watch() as watch:
        began, flying, stop = time.monotonic(), threading.Event(), threading.Event()
        expected = _recall(kind)

        def look() -> None:
            while not (flying.is_set() or stop.wait(_INTERVAL)):
                _show(bar, *compiling(watch, expected, time.monotonic() - began))

        def progress(text: str, share: float) -> None:
            if text == "flying" and not flying.is_set():
                flying.set()
                _remember(kind, Expected(time.monotonic() - began, _taken(watch)))
            if text == "flying":
                _show(bar, text, share)

        looking = threading.Thread(target=look, daemon=True)
        if not bar.disable:
            looking.start()
        try:
            yield progress
        finally:
            stop.set()
            if looking.ident is not None:
                looking.join()


def compiling(watch: "Watch", expected: Expected, elapsed: float) -> tuple[str, float]:
    """What to say after so many seconds, and the share that is done.

    While one program takes long the share goes on with the time, up to where that program would be done; what is left
    takes as long as expected, or longer where all of it has taken longer already.
    """
    ended, running = watch.ended(), watch.running()
    done = expected.share(ended)
    soon = expected.share({name: ended.get(name, 0) + (name in running) for name in expected.programs})
    by_time = elapsed / max(expected.seconds, 1e-9)
    share = min(max(done, min(by_time, soon if running else max(soon, 0.05))), 0.99)
    left = max((1.0 - share) * max(expected.seconds, elapsed), 1.0)
    words = dict.fromkeys(_WORDS[name] for name in running if name in _WORDS)
    what = f"compiling {', '.join(words)}" if words else "loading" if not ended else "compiling"
    return f"{what}, about {left:.0f} s left", share


def _show(bar: "tqdm", text: str, share: float) -> None:
    bar.set_description_str(text, refresh=False)
    bar.n = min(share, 1.0)
    bar.refresh()


def _taken(watch: "Watch") -> dict[str, list[float]]:
    """By function, how many programs there were and the seconds of them; those that took nothing are left out."""
    seconds, ended = watch.seconds(), watch.ended()
    return {name: [ended[name], round(took, 2)] for name, took in seconds.items() if took >= 0.1}


def _place(kind: str) -> Path | None:
    from jaxplan.files import cache_root

    root = cache_root()
    return None if root is None else root / f"compiling-{kind}.json"


def _recall(kind: str) -> Expected:
    """What compiling took last time; ``USUAL`` where that is not known."""
    path = _place(kind)
    try:
        stored: Any = json.loads(path.read_text(encoding="utf-8")) if path is not None else {}
        if stored.pop("format") != _FORMAT:
            return USUAL
        programs = {str(name): [float(number) for number in pair] for name, pair in stored["programs"].items()}
        found = Expected(float(stored["seconds"]), programs)
        return found if found.seconds > 0.0 and all(len(pair) == 2 for pair in programs.values()) else USUAL
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return USUAL


def _remember(kind: str, taken: Expected) -> None:
    """Keep what compiling took, as far as the disk allows."""
    from jaxplan.files import write_atomically

    path = _place(kind)
    with contextlib.suppress(OSError):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, json.dumps({"format": _FORMAT, **taken._asdict()}))
