"""A replay in a browser, served by viser: while an interception is flown, and afterwards.

The extra ``view`` installs viser. What is drawn is the same as on the page of ``html``; the panel has the same numbers.
"""

import contextlib
import html
import io
import socket
import time
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError, ResourceError
from jaxplan.io.cycles import SavedCycle, SavedPrediction
from jaxplan.viz.html import CAPTURE_RADIUS, SIGMAS
from jaxplan.viz.replay import Instant, Replay, at, curves_at, groups_of
from jaxplan.viz.scene import Surface
from jaxplan.viz.surface import cut_height, padding_surface, world_surface
from jaxplan.viz.words import GROUPS, REASONS, STATUSES

HOST = "127.0.0.1"
"""Nobody else's machine may look."""
_RATE = 30.0
"""Pictures a second."""
_SPEEDS = ("0.1", "0.25", "0.5", "1", "2")
DEFENDER, TARGET, PLAN, MEETING, PREDICTED = (0, 114, 178), (213, 94, 0), (0, 77, 56), (240, 192, 0), (123, 85, 208)
_LINES = {
    "flown": (DEFENDER, 5.0),
    "target": (TARGET, 3.0),
    "plan_flown": ((86, 180, 233), 2.5),
    "ahead": (PLAN, 3.5),
    "rest": ((120, 160, 148), 2.0),
}
"""Colour and width in pixels of the paths in ``replay.Curves``."""


class _Controls(NamedTuple):
    """What there is to press and to read."""

    title: Any
    time: Any
    play: Any
    speed: Any
    follow: Any
    padding: Any
    candidates: Any
    prediction: Any
    panel: Any


class Viewer:
    """Serves one replay, which may grow.

    Raises:
        InputError: the port is none.
        ResourceError: viser is not installed, or the port is taken.
    """

    def __init__(self, replay: Replay, port: int) -> None:
        try:
            import viser
        except ImportError as error:
            hint = "install it with: pip install 'jaxplan[view]', or write a page with --html FILE"
            raise ResourceError(f"view: viser is not installed ({error}); {hint}") from error
        _require_free(port)
        self.replay = replay
        self.url = f"http://{HOST}:{port}"
        with contextlib.redirect_stdout(io.StringIO()):  # a banner
            self._server = viser.ViserServer(host=HOST, port=port, label="jaxplan", verbose=False)
        self._scene = self._server.scene
        self._playing, self._drawn = False, (-np.inf, 0)
        self._cycle: SavedCycle | None = None
        self._size = max(0.15, 0.011 * replay.world.diagonal)
        self._draw_world()
        self._controls = self._add_controls()
        self.draw()

    def show(self, replay: Replay) -> None:
        """Show an episode as it is now, at its newest instant."""
        self.replay = replay
        self._controls.title.content = _title(replay)
        self._controls.time.max = float(replay.times[-1])
        self._controls.time.value = float(replay.times[-1])
        self.draw()

    def serve(self, seconds: float = np.inf) -> None:
        """Play, and answer to the controls, until interrupted, or for so long [s]."""
        until, before = time.monotonic() + seconds, time.monotonic()
        while time.monotonic() < until:
            time.sleep(1.0 / _RATE)
            now = time.monotonic()
            if self._playing:
                self._advance(float(self._controls.speed.value) * (now - before))
            before = now
            self.draw()

    def wait(self, seconds: float) -> None:
        """Until somebody looks, or for so long [s]."""
        until = time.monotonic() + seconds
        while not self._server.get_clients() and time.monotonic() < until:
            time.sleep(0.1)

    def stop(self) -> None:
        """Close the server."""
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def draw(self) -> None:
        """Draw the instant of the slider, where that is not what is drawn already."""
        now = at(self.replay, float(self._controls.time.value))
        state = (now.time, len(self.replay.cycles))
        if state == self._drawn:
            return
        with self._server.atomic():
            self._draw_paths(now)
            cycle = self.replay.cycles[now.cycle] if now.cycle >= 0 else None
            if cycle is not self._cycle:
                self._draw_cycle(cycle)
                self._cycle = cycle
            self._controls.panel.content = panel(self.replay, now)
        if self._controls.follow.value:
            self._follow(now.position)
        self._drawn = state

    def _draw_world(self) -> None:
        lower, upper = np.asarray(self.replay.world.bounds, dtype=float)
        surface = world_surface(self.replay.world)
        low = surface.vertices[surface.faces][..., 2].min(axis=1)
        surface = Surface(surface.vertices, surface.faces[low <= cut_height(surface, self.replay.position)])
        self._scene.set_up_direction("+z")
        middle, (width, depth, height) = (lower + upper) / 2.0, upper - lower
        floor = (float(middle[0]), float(middle[1]), float(lower[2]))
        grid = {"cell_size": 1.0, "section_size": 5.0, "plane_color": (250, 251, 253), "plane_opacity": 1.0}
        self._scene.add_grid("/floor", width=float(width), height=float(depth), position=floor, **grid)
        if len(surface.faces):
            self._scene.add_mesh_simple(
                "/world", *surface, color=(188, 197, 209), flat_shading=True, side="double", cast_shadow=False
            )
            grown = padding_surface(self.replay.world, self.replay.padding)
            self._padding = self._scene.add_mesh_simple(
                "/padding", *grown, color=(233, 165, 59), opacity=0.2, visible=False, cast_shadow=False
            )
        else:
            self._padding = None
        camera, reach = self._server.initial_camera, float(np.linalg.norm([width, depth, height]))
        camera.position = tuple(middle + 0.9 * reach * np.array([-0.42, -0.62, 0.66]))
        camera.look_at = tuple(middle)

    def _add_controls(self) -> _Controls:
        gui, replay = self._server.gui, self.replay
        title = gui.add_markdown(_title(replay))
        first, last = float(replay.times[0]), float(replay.times[-1])
        slider = gui.add_slider("time [s]", min=first, max=max(last, first + 0.01), step=0.01, initial_value=first)
        play = gui.add_button("Play / pause")
        steps = gui.add_button_group("cycle", ("before", "next"))
        speed = gui.add_dropdown("speed", _SPEEDS, initial_value="0.5")
        boxes = {name: gui.add_checkbox(label, value) for name, (label, value) in _BOXES.items()}
        play.on_click(lambda _: self._toggle())
        steps.on_click(lambda event: self.step(1 if event.target.value == "next" else -1))
        boxes["padding"].on_update(lambda _: self._show_padding())
        for name in ("candidates", "prediction"):
            boxes[name].on_update(lambda _: self._redraw())
        return _Controls(title, slider, play, speed, **boxes, panel=gui.add_html(""))

    def step(self, by: int) -> None:
        """Go to the next cycle, or to the one before."""
        self._playing = False
        times = np.array([cycle.time for cycle in self.replay.cycles])
        now = float(self._controls.time.value)
        there = times[times > now + 1e-3] if by > 0 else times[times < now - 1e-3][::-1]
        if len(there):
            self._controls.time.value = float(there[0])

    def _toggle(self) -> None:
        self._playing = not self._playing
        if self._playing and self._controls.time.value >= self.replay.times[-1] - 1e-3:
            self._controls.time.value = float(self.replay.times[0])

    def _advance(self, seconds: float) -> None:
        later = min(float(self._controls.time.value) + seconds, float(self.replay.times[-1]))
        self._controls.time.value = later
        self._playing = later < float(self.replay.times[-1])

    def _show_padding(self) -> None:
        if self._padding is not None:
            self._padding.visible = self._controls.padding.value

    def _redraw(self) -> None:
        self._drawn, self._cycle = (-np.inf, 0), None

    def _draw_paths(self, now: Instant) -> None:
        curves = curves_at(self.replay, now)
        for name, (colour, width) in _LINES.items():
            curve = getattr(curves, name)
            self._line(f"/{name}", np.stack([curve[:-1], curve[1:]], axis=1), colour, width)
        size = self._size
        self._ball("/meeting", curves.meeting, 0.8 * size, MEETING)
        self._ball("/stop", curves.stop, 0.7 * size, PLAN)
        quat = tuple(np.asarray(self.replay.quat_wxyz[now.row], dtype=float))
        self._ball("/defender", now.position[None], size, DEFENDER)
        self._scene.add_frame(
            "/attitude", axes_length=3.0 * size, axes_radius=0.15 * size, wxyz=quat, position=tuple(now.position)
        )
        if np.isfinite(now.target).all():
            self._ball("/quarry", now.target[None], size, TARGET)
            self._ball("/met", now.target[None], CAPTURE_RADIUS, TARGET, opacity=0.15)

    def _draw_cycle(self, cycle: SavedCycle | None) -> None:
        shown = cycle is not None and self._controls.candidates.value
        groups = groups_of(cycle.reasons) if cycle is not None else np.zeros(0, dtype=int)
        goals, lines, of = np.zeros((0, 3)), np.zeros((0, 2, 3)), np.zeros(0, dtype=int)
        if cycle is not None and shown:
            known = np.isfinite(cycle.goals).all(axis=1)
            goals, of = cycle.goals[known], groups[known]
            pairs = np.stack([cycle.curves[:, :-1], cycle.curves[:, 1:]], axis=2)
            lines = pairs.reshape(-1, 2, 3)
            paint = np.repeat(groups[cycle.curve_of], pairs.shape[1])
            self._line("/trajectories", lines, _rgb(paint)[:, None].repeat(2, axis=1), 1.2)
        else:
            self._line("/trajectories", lines, (0, 0, 0), 1.2)
        self._scene.add_point_cloud(
            "/candidates", goals, _rgb(of), point_size=0.4 * self._size, point_shape="circle", precision="float32"
        )
        prediction = cycle.prediction if cycle is not None and self._controls.prediction.value else None
        self._draw_prediction(prediction)

    def _draw_prediction(self, prediction: SavedPrediction | None) -> None:
        self._scene.remove_by_name("/prediction")
        if prediction is None:
            return
        variances, axes = np.linalg.eigh(prediction.covariances)
        axes = axes * np.sign(np.linalg.det(axes))[..., None, None]
        half = SIGMAS * np.sqrt(np.clip(variances, 0.0, None))
        for step, component in np.argwhere(half.max(axis=-1) > 1e-3).tolist():
            weight = float(prediction.weights[component])
            self._scene.add_icosphere(
                f"/prediction/{step}-{component}",
                color=PREDICTED,
                scale=tuple(np.maximum(half[step, component], 1e-3)),
                opacity=0.05 + 0.2 * float(np.sqrt(weight)),
                wxyz=_quaternion(axes[step, component]),
                position=tuple(prediction.means[step, component]),
                subdivisions=2,
                cast_shadow=False,
            )

    def _line(self, name: str, segments: Float[np.ndarray, "n 2 3"], colour: Any, width: float) -> None:
        self._scene.add_line_segments(name, segments, colour, thickness=width, thickness_units="screen")

    def _ball(
        self, name: str, place: Float[np.ndarray, "n 3"], radius: float, colour: Any, opacity: float | None = None
    ) -> None:
        """A ball at the one place there is, if there is one."""
        if len(place):
            self._scene.add_icosphere(
                name, radius, colour, opacity=opacity, position=tuple(place[0]), cast_shadow=False
            )
        else:
            self._scene.remove_by_name(name)

    def _follow(self, position: Float[np.ndarray, "3"]) -> None:
        for client in self._server.get_clients().values():
            moved = position - np.asarray(client.camera.look_at)
            with client.atomic():
                client.camera.position = np.asarray(client.camera.position) + moved
                client.camera.look_at = position


_BOXES = {
    "follow": ("follow the defender", False),
    "padding": ("padding", False),
    "candidates": ("candidates", True),
    "prediction": ("prediction", True),
}


def panel(replay: Replay, now: Instant) -> str:
    """The numbers of an instant and of its cycle, as HTML."""
    apart = float(np.linalg.norm(now.position - now.target))
    rows: list[tuple[str, str]] = [("time", f"{now.time:.2f} s"), ("to the target", _number(apart, "m"))]
    if now.plan >= 0:
        plan = replay.plans[now.plan]
        rows += [
            ("the target is met in", _number(plan.arrival_time - now.time, "s")),
            ("alpha", _number(plan.alpha)),
            ("probability of being tracked", _number(plan.probability)),
        ]
    if now.cycle < 0:
        return _rows(rows)
    cycle = replay.cycles[now.cycle]
    rows.append((f"cycle {now.cycle + 1} of {len(replay.cycles)}", STATUSES[cycle.status][0]))
    rows += [("takes over after", f"{1e3 * cycle.latency:.0f} ms"), ("candidates", str(cycle.generated))]
    names = {(reason.name or "").lower(): text for reason, text in REASONS.items()}
    rows += [(f"&ensp;{names.get(name, name)}", str(count)) for name, count in cycle.rejected.items()]
    rows.append(("planning", f"{sum(cycle.stage_ms.values()):.0f} ms"))
    rows += [(f"&ensp;{name}", f"{ms:.1f} ms") for name, ms in cycle.stage_ms.items() if ms > 0.0]
    return _rows(rows)


def _title(replay: Replay) -> str:
    return f"**{html.escape(replay.title)}**\n\n{html.escape(replay.subtitle)}"


def _rows(rows: list[tuple[str, str]]) -> str:
    cells = "".join(f"<tr><td>{name}</td><td style='text-align:right'>{value}</td></tr>" for name, value in rows)
    return f"<table style='width:92%;margin:0 4%;font-size:0.85em'>{cells}</table>"


def _number(value: float, unit: str = "") -> str:
    return f"{value:.2f} {unit}".rstrip() if np.isfinite(value) else "–"


def _rgb(groups: np.ndarray) -> np.ndarray:
    """Colours from 0 to 255 of candidates' groups."""
    table = np.array([[int(group.colour[i : i + 2], 16) for i in (1, 3, 5)] for group in GROUPS], dtype=np.uint8)
    return table[groups]


def _quaternion(rotation: Float[np.ndarray, "3 3"]) -> tuple[float, float, float, float]:
    """wxyz."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return w, x, y, z


def _require_free(port: int) -> None:
    """viser would take another port without a word."""
    if not 0 < port < 65536:
        raise InputError(f"--port: have {port}, want a number from 1 to 65535")
    with contextlib.closing(socket.socket()) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise ResourceError(f"--port: {port} cannot be used ({error.strerror}); choose another --port") from error
