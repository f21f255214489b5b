"""A replay as an animated GIF or an MP4: from above and in perspective, side by side."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib import animation
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from jaxplan.errors import ResourceError
from jaxplan.io.cycles import SavedCycle
from jaxplan.viz.episode import COMMITTED, DEFENDER, TARGET
from jaxplan.viz.replay import Replay, at, curves_at, groups_of
from jaxplan.viz.scene import EDGE, draw_world
from jaxplan.viz.surface import Surface, coarsened, world_surface
from jaxplan.viz.words import GROUPS

FRAME_RATE = 20
"""Pictures a second."""
SLOWER = 2.0
"""Times slower than flown, as an interception takes a second or two (arbitrary)."""
HOLD = 1.0
"""Seconds for which the end is shown."""
MOST_FRAMES = 600
"""Of an animation; a longer flight is shown in larger steps."""
_FACES = 4000
"""Triangles of the world in perspective (arbitrary)."""
_FAR = 1e6
"""m; where what has no place is drawn: outside of the picture."""
_WIDTH, _DPI = 9.6, 84
"""Inches and pixels an inch."""
MEETING = "#F0C000"


class Camera(NamedTuple):
    """A place that looks at another one, with z up: a pinhole."""

    eye: Float[np.ndarray, "3"]
    """Metres, world."""
    centre: Float[np.ndarray, "3"]
    """What is in the middle of the picture [m, world]."""

    def project(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Right and up in the picture, in units of the distance to the picture's middle."""
        away, right, up = self._axes()
        offset = np.nan_to_num(points, nan=_FAR) - self.eye
        depth = np.maximum(offset @ away, 1e-3 * float(np.linalg.norm(self.centre - self.eye)))
        return np.stack([offset @ right, offset @ up], axis=-1) / depth[..., None]

    def depth(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
        """How far in front of the eye [m]."""
        return (points - self.eye) @ self._axes()[0]

    def _axes(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        away = (self.centre - self.eye) / np.linalg.norm(self.centre - self.eye)
        right = np.cross(away, [0.0, 0.0, 1.0])
        right = right / np.linalg.norm(right)
        return away, right, np.cross(right, away)


class Artists(NamedTuple):
    """What changes in one view from picture to picture."""

    trajectories: LineCollection
    candidates: PathCollection
    flown: Line2D
    target: Line2D
    ahead: Line2D
    rest: Line2D
    meeting: Line2D
    stop: Line2D
    defender: Line2D
    quarry: Line2D


def animate(replay: Replay, path: Path) -> int:
    """Write an animation into ``path``, whose ending is .gif or .mp4; returns how many pictures it has.

    Raises:
        ResourceError: an MP4 is wanted and there is no ffmpeg.
    """
    if path.suffix == ".mp4" and not animation.FFMpegWriter.isAvailable():
        raise ResourceError("an MP4 needs ffmpeg, which is not installed; install it, or write a GIF instead")
    figure, views, caption = _figure(replay)
    instants = frame_times(replay)
    if path.suffix == ".gif":
        pictures = []
        for instant in instants:
            _draw(replay, float(instant), views, caption)
            figure.canvas.draw()
            pictures.append(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[..., :3]))  # type: ignore[attr-defined]
        _write_gif(pictures, path)
        return len(instants)
    writer = animation.FFMpegWriter(fps=FRAME_RATE, codec="h264", extra_args=["-pix_fmt", "yuv420p"])
    with writer.saving(figure, str(path), _DPI):
        for instant in instants:
            _draw(replay, float(instant), views, caption)
            writer.grab_frame()
    return len(instants)


def _write_gif(pictures: list[Image.Image], path: Path) -> None:
    """One palette for all pictures, so that no colour changes from one to the next, and no dithering, for the size."""
    some = pictures[:: max(len(pictures) // 6, 1)]
    width, height = some[0].size
    sheet = Image.new("RGB", (width, height * (len(some) + 1)))
    for row, picture in enumerate(some):
        sheet.paste(picture, (0, row * height))
    colours = [DEFENDER, TARGET, COMMITTED, MEETING, *(group.colour for group in GROUPS)]
    for place, colour in enumerate(colours):  # what is small in the pictures counts, too
        part = width // len(colours)
        sheet.paste(colour, (place * part, height * len(some), (place + 1) * part, sheet.height))
    palette = sheet.quantize(128)
    frames = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=round(1000 / FRAME_RATE), loop=0)


def frame_times(replay: Replay) -> Float[np.ndarray, "f"]:
    """The instants that are shown [s]; the last one as long as ``HOLD``."""
    first, last = float(replay.times[0]), float(replay.times[-1])
    if replay.cycles:
        first = max(first, replay.cycles[0].time - 0.2)
    count = int(np.clip(round((last - first) * SLOWER * FRAME_RATE), 1, MOST_FRAMES))
    return np.concatenate([np.linspace(first, last, count), np.full(round(HOLD * FRAME_RATE), last)])


def _figure(replay: Replay) -> tuple[Figure, list[tuple[Artists, Any]], Any]:
    """The picture with all that stays, and what changes in it: a view's artists and how it sees points."""
    bounds = np.asarray(replay.world.bounds, dtype=float)
    size = bounds[1] - bounds[0]
    height = float(np.clip(0.5 * _WIDTH * size[1] / size[0], 2.4, 4.8)) + 0.95
    figure = Figure(figsize=(_WIDTH, height), facecolor="white")
    FigureCanvasAgg(figure)
    low, tall = 0.28 / height, 1.0 - 0.9 / height
    above = figure.add_axes((0.01, low, 0.48, tall))
    beside = figure.add_axes((0.5, low, 0.49, tall))
    figure.text(0.015, 1.0 - 0.3 / height, replay.title, fontsize=13, fontweight="bold")
    caption = figure.text(0.985, 1.0 - 0.3 / height, "", fontsize=10, ha="right", family="monospace")
    figure.text(0.015, 1.0 - 0.53 / height, replay.subtitle, fontsize=8.5, color=EDGE)
    _legend(figure)
    draw_world(above, replay.world, 2, float(np.median(replay.position[:, 2])), replay.position[-1])
    above.set(xlim=bounds[:, 0] + [-0.1, 0.1], ylim=bounds[:, 1] + [-0.1, 0.1], aspect="equal")
    camera = _camera(bounds)
    _draw_room(beside, camera, bounds)
    _draw_surface(beside, camera, coarsened(world_surface(replay.world), _FACES))
    for axes in (above, beside):
        axes.set_axis_off()
    return figure, [(_artists(above), _from_above), (_artists(beside), camera.project)], caption


def _from_above(points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    return points[..., :2]


def _camera(bounds: Float[np.ndarray, "2 3"]) -> Camera:
    """Looks at the room from its corner of small x and y."""
    centre, reach = bounds.mean(axis=0), float(np.linalg.norm(bounds[1] - bounds[0]))
    return Camera(centre + 1.25 * reach * np.array([-0.42, -0.62, 0.66]), centre)


def _draw_room(axes: Axes, camera: Camera, bounds: Float[np.ndarray, "2 3"]) -> None:
    """The floor's metres and the room's edges, and limits that show all of it."""
    (x0, y0, z0), (x1, y1, _) = bounds
    step = max(1, round(max(x1 - x0, y1 - y0) / 20))
    grid = [[[x, y0, z0], [x, y1, z0]] for x in np.arange(np.ceil(x0), x1 + 1e-9, step)]
    grid += [[[x0, y, z0], [x1, y, z0]] for y in np.arange(np.ceil(y0), y1 + 1e-9, step)]
    corners = np.array([[bounds[i][0], bounds[j][1], bounds[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    edges = [corners[[i, i | bit]] for i in range(8) for bit in (1, 2, 4) if not i & bit]
    axes.add_collection(
        LineCollection(list(camera.project(np.array(grid))), colors="#e3e7ec", linewidths=0.6, zorder=0.5)
    )
    axes.add_collection(
        LineCollection(list(camera.project(np.array(edges))), colors="#aab2bd", linewidths=0.8, zorder=0.6)
    )
    seen = camera.project(corners)
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = 0.03 * (high - low)
    axes.set(xlim=(low[0] - margin[0], high[0] + margin[0]), ylim=(low[1] - margin[1], high[1] + margin[1]))
    axes.set_aspect("equal")


def _draw_surface(axes: Axes, camera: Camera, surface: Surface) -> None:
    """Triangles from far to near, lighter where they face up; what flies is seen through them."""
    triangles = surface.vertices[surface.faces]
    if not len(triangles):
        return
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    towards = np.einsum("fa,fa->f", normals, camera.eye - triangles.mean(axis=1)) > 0.0
    light = 0.66 + 0.22 * np.abs(normals[:, 2]) + 0.1 * np.abs(normals[:, 0])
    order = np.argsort(-camera.depth(triangles.mean(axis=1)))
    order = order[towards[order]]
    colours = light[order, None] * np.array([0.86, 0.9, 0.96])
    faces = PolyCollection(
        list(camera.project(triangles[order])), facecolors=colours, edgecolors=colours, linewidths=0.3
    )
    axes.add_collection(faces)


def _artists(axes: Axes) -> Artists:
    def line(**style: Any) -> Line2D:
        return axes.plot([], [], **style)[0]

    trajectories = LineCollection([], linewidths=0.6, alpha=0.5, zorder=3)
    axes.add_collection(trajectories)
    dot = {"ls": "none", "markeredgecolor": "white"}
    return Artists(
        trajectories=trajectories,
        candidates=axes.scatter([], [], s=5, linewidths=0, zorder=3.5),
        flown=line(color=DEFENDER, lw=2.4, zorder=6, solid_capstyle="round"),
        target=line(color=TARGET, lw=1.8, ls=(0, (4, 1.5)), zorder=5),
        ahead=line(color=COMMITTED, lw=1.8, zorder=5.5),
        rest=line(color=COMMITTED, lw=1.1, ls=":", zorder=5.4),
        meeting=line(marker="*", color=MEETING, ms=13, mew=0.8, zorder=7, **dot | {"markeredgecolor": "black"}),
        stop=line(marker="P", color=COMMITTED, ms=7, zorder=6.5, **dot),
        defender=line(marker="o", color=DEFENDER, ms=8.5, zorder=8, **dot),
        quarry=line(marker="s", color=TARGET, ms=7, zorder=7.5, **dot),
    )


def _draw(replay: Replay, time: float, views: list[tuple[Artists, Any]], caption: Any) -> None:
    """Move everything to an instant."""
    now = at(replay, time)
    cycle = replay.cycles[now.cycle] if now.cycle >= 0 else None
    curves = curves_at(replay, now)._asdict() | {"defender": now.position[None], "quarry": now.target[None]}
    for artists, see in views:
        for name in Artists._fields[2:]:
            getattr(artists, name).set_data(*see(curves[name]).T)
        _draw_candidates(artists, cycle, see)
    apart = float(np.linalg.norm(now.position - now.target))
    caption.set_text(f"{now.time:5.2f} s" + (f"   {apart:5.2f} m apart" if np.isfinite(apart) else ""))


def _draw_candidates(artists: Artists, cycle: SavedCycle | None, see: Any) -> None:
    if cycle is None:
        return
    groups, colours = groups_of(cycle.reasons), np.array([group.colour for group in GROUPS])
    order = np.argsort(-groups, kind="stable")
    artists.candidates.set_offsets(see(cycle.goals[order]))
    artists.candidates.set_facecolor(colours[groups[order]].tolist())
    order = np.argsort(-groups[cycle.curve_of], kind="stable")
    artists.trajectories.set_segments(list(see(cycle.curves[order])))
    artists.trajectories.set_color(colours[groups[cycle.curve_of][order]].tolist())


def _legend(figure: Figure) -> None:
    entries = [
        (Line2D([], [], color=DEFENDER, lw=2.4), "defender"),
        (Line2D([], [], color=TARGET, lw=1.8, ls=(0, (4, 1.5))), "target"),
        (Line2D([], [], color=COMMITTED, lw=1.8), "plan"),
        (Line2D([], [], marker="*", ls="none", color=MEETING, markeredgecolor="black", ms=9), "meeting"),
        (Line2D([], [], marker="P", ls="none", color=COMMITTED, ms=6), "stop"),
        *((Line2D([], [], marker="o", ls="none", color=GROUPS[i].colour, ms=4), GROUPS[i].name) for i in (0, 3, 5, 6)),
    ]
    style = {"ncols": len(entries), "frameon": False, "fontsize": 7.5, "handlelength": 1.5, "columnspacing": 1.3}
    figure.legend(*zip(*entries, strict=True), loc="lower center", borderaxespad=0.1, **style)
