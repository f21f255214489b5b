"""A replay as one HTML file: a page that draws with WebGL 2, its controls, and the data, with nothing to load.

The page's parts are in ``page/``: ``scene.js`` draws, ``replay.js`` knows what there is to see, ``controls.js`` is the
panel. Arrays stand in it as base64 of little-endian numbers, with type and shape.
"""

import base64
import html
import json
from importlib import resources
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxplan.io.cycles import CURVE_POINTS, SavedCycle, SavedPrediction
from jaxplan.io.files import plain
from jaxplan.status import Note, PlanStatus
from jaxplan.viz.replay import Replay, groups_of
from jaxplan.viz.scene import sharp_edges
from jaxplan.viz.surface import NOTHING, cut_height, padding_surface, world_surface
from jaxplan.viz.words import GROUPS, REASONS, STATUSES

PLAN_POINTS = 100
"""Points of a plan, evenly spaced in time; ``replay.js`` counts on it."""
SIGMAS = 2.0
"""Standard deviations at which a prediction's ellipsoids are drawn."""
CAPTURE_RADIUS = 0.4
"""m; what counts as an interception (paper, Sec. IV), as ``jaxplan.interception.INTERCEPTION_RADIUS``."""
MOST_EDGES = 30_000
"""Of a world; more of them hide it."""
_RADIUS = 0.17
"""m; arm of the drawn vehicles with half a propeller, which are drawn larger from far away."""


def replay_page(replay: Replay) -> str:
    """The whole page."""
    parts = resources.files("jaxplan.viz") / "page"
    page, style, *scripts = (
        (parts / name).read_text(encoding="utf-8")
        for name in ("page.html", "style.css", "scene.js", "replay.js", "controls.js")
    )
    data = json.dumps(replay_data(replay), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    pieces = {"title": html.escape(replay.title), "style": style, "script": "\n".join(scripts), "data": data}
    for name, text in pieces.items():
        page = page.replace(f"/*{name}*/", text, 1)
    return page


def replay_data(replay: Replay) -> dict[str, Any]:
    """Everything that the page is told, as plain JSON."""
    world, padding = world_surface(replay.world), NOTHING
    if len(world.faces):
        padding = padding_surface(replay.world, replay.padding)
    edges = sharp_edges(world) if len(world.faces) else np.zeros((0, 2, 3))
    ellipsoids = [_ellipsoids(cycle.prediction) for cycle in replay.cycles]
    means = [_means(cycle.prediction) for cycle in replay.cycles]
    curves = _stacked([c.curves for c in replay.cycles], (CURVE_POINTS, 3))
    arrays = {
        "times": replay.times,
        "position": replay.position,
        "quat": replay.quat_wxyz,
        "target": replay.target,
        "world_vertices": world.vertices,
        "world_faces": world.faces.astype(np.uint32),
        "world_edges": edges if len(edges) <= MOST_EDGES else edges[:0],
        "padding_vertices": padding.vertices,
        "padding_faces": padding.faces.astype(np.uint32),
        "plan_points": _stacked([np.asarray(p.spline.sample(PLAN_POINTS)[1])[:, :3] for p in replay.plans], (3,)),
        "goals": _stacked([c.goals for c in replay.cycles], (3,)),
        "goal_groups": _stacked([groups_of(c.reasons) for c in replay.cycles], ()).astype(np.uint8),
        "curves": curves,
        "curve_groups": _stacked([groups_of(c.reasons)[c.curve_of] for c in replay.cycles], ()).astype(np.uint8),
        "ellipsoids": _stacked([found for found, _ in ellipsoids], (12,)),
        "ellipsoid_weights": _stacked([weights for _, weights in ellipsoids], ()),
        "means": _stacked(means, (3,)),
    }
    counts = np.array(
        [
            (len(cycle.goals), len(cycle.curves), len(found), len(mean))
            for cycle, (found, _), mean in zip(replay.cycles, ellipsoids, means, strict=True)
        ]
    ).reshape(-1, 4)
    starts = np.cumsum(counts, axis=0) - counts
    spans = np.stack([starts, counts], axis=-1).tolist()
    return {
        "title": replay.title,
        "subtitle": replay.subtitle,
        "bounds": plain(np.asarray(replay.world.bounds, dtype=float)),
        "ceiling": plain(cut_height(world, replay.position)),
        "radius": _RADIUS,
        "capture": CAPTURE_RADIUS,
        "groups": [{"name": group.name, "colour": group.colour} for group in GROUPS],
        "statuses": {int(status): {"text": text, "colour": colour} for status, (text, colour) in STATUSES.items()},
        "reasons": {(reason.name or "").lower(): text for reason, text in REASONS.items()},
        "plans": [
            {
                "start": plan.start_time,
                "end": plan.start_time + float(plan.spline.duration),
                "arrival": plain(plan.arrival_time),
                "meets": plan.status == PlanStatus.INTERCEPT,
                "alpha": plain(plan.alpha),
                "probability": plain(plan.probability),
            }
            for plan in replay.plans
        ],
        "cycles": [_cycle(cycle, span) for cycle, span in zip(replay.cycles, spans, strict=True)],
        "arrays": {name: encoded(array) for name, array in arrays.items()},
    }


def encoded(array: np.ndarray) -> dict[str, Any]:
    """An array as the page reads it; numbers with a point become single precision."""
    small = array.astype("<f4") if array.dtype.kind == "f" else array.astype(array.dtype.newbyteorder("<"))
    text = base64.b64encode(np.ascontiguousarray(small).tobytes()).decode()
    return {"dtype": small.dtype.name, "shape": list(small.shape), "base64": text}


def _cycle(cycle: SavedCycle, spans: list[list[int]]) -> dict[str, Any]:
    """A cycle's numbers, and which rows of the arrays are its own: first one and how many."""
    names = [note.name.lower().replace("_", " ") for note in Note if note in cycle.note and note.name]
    return {
        "time": cycle.time,
        "status": int(cycle.status),
        "plan": cycle.plan,
        "latency": plain(cycle.latency),
        "deviation": cycle.deviation,
        "sooner": cycle.sooner,
        "notes": names,
        "stages": plain(cycle.stage_ms),
        "generated": cycle.generated,
        "rejected": cycle.rejected,
        "groups": np.bincount(groups_of(cycle.reasons), minlength=len(GROUPS)).tolist(),
        **dict(zip(("goals", "curves", "ellipsoids", "mean"), spans, strict=True)),
    }


def _ellipsoids(prediction: SavedPrediction | None) -> tuple[Float[np.ndarray, "e 12"], Float[np.ndarray, "e"]]:
    """Half axes at ``SIGMAS`` [m], then the centre, of every component that is uncertain; and what each weighs."""
    if prediction is None:
        return np.zeros((0, 12)), np.zeros(0)
    steps, components = prediction.means.shape[:2]
    variances, axes = np.linalg.eigh(prediction.covariances)
    half = SIGMAS * np.sqrt(np.clip(variances, 0.0, None))[..., None, :] * axes
    columns = np.swapaxes(half, -1, -2).reshape(steps * components, 9)
    weights = np.tile(prediction.weights, steps)
    shown = (variances.max(axis=-1).ravel() > 1e-8) & (weights > 0.01)
    return np.concatenate([columns, prediction.means.reshape(-1, 3)], axis=1)[shown], weights[shown]


def _means(prediction: SavedPrediction | None) -> Float[np.ndarray, "s 3"]:
    """The expected positions [m, world], of the components that are kept."""
    if prediction is None or not len(prediction.weights):
        return np.zeros((0, 3))
    return np.einsum("c,sca->sa", prediction.weights / prediction.weights.sum(), prediction.means)


def _stacked(arrays: list[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """All rows one after the other; each row of this shape, which counts where there are none."""
    return np.concatenate([np.zeros((0, *shape)), *arrays])
