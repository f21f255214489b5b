"""Mixtures of windows as files: what is stored, how it is checked, and which one fits a world.

A model is two files of one name. ``NAME.npy`` is a float32 array with a row for each component: weight, mean, and the
lower triangle of the covariance's Cholesky factor, row by row. ``NAME.json`` is its card: what the numbers mean, the
SHA-256 of the array's file, and where they come from (command, seed, hash of the data, scores).

Coordinates of a window: the newest observed position in the world where the model belongs to a world, nothing in open
space; then the earlier observed positions, oldest first, and the future ones, all relative to the newest observed.
"""

import dataclasses
import hashlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxplan.blas import on_one_thread
from jaxplan.errors import FileError, InputError
from jaxplan.files import read_limited, write_atomically
from jaxplan.prediction.mixture import ConditionalMixture, conditional_mixture
from jaxplan.world.obstacles import World

FORMAT = "jaxplan target model 1"
GENERIC = "generic"
"""Name of the models for worlds that have none of their own."""
_SHIPPED = Path(__file__).parent / "models"
_LARGEST_FILE = 64 * 2**20
_LARGEST_CARD = 2**20
_WANTED = "a target model, written by jaxplan train gmm, beside its card"
_SAME_BOUNDS = 1e-3
"""Metres by which a room may differ from the one that a model was made for."""


@dataclasses.dataclass(frozen=True)
class TargetModel:
    """A mixture over windows of target positions; float64."""

    name: str
    observations: int
    """N_obs."""
    steps: int
    """N_pred."""
    dt: float
    """Seconds between the positions of a window."""
    bounds: Float[np.ndarray, "2 3"] | None
    """The room [m] that the model belongs to; None in open space."""
    weights: Float[np.ndarray, "k"]
    means: Float[np.ndarray, "k d"]
    factors: Float[np.ndarray, "k d d"]
    """Lower triangular factors of the covariances."""

    @property
    def observed(self) -> int:
        """Coordinates that are observed."""
        return 3 * (self.observations - 1) + (0 if self.bounds is None else 3)

    @on_one_thread
    def conditional(self, seen: int | None = None, noise: float = 0.0) -> ConditionalMixture:
        """The mixture made ready for conditioning on the newest ``seen`` positions of a window; None: on all.

        What a window has in the place of the others does not count, so that programs are the same for all. ``noise``
        is the standard deviation [m] of the positions that will be seen, on top of what the mixture learned with.
        """
        counts = np.arange(self.observations - 1) >= self.observations - (self.observations if seen is None else seen)
        coordinates = np.repeat(counts, 3)
        if self.bounds is not None:
            coordinates = np.append(np.ones(3, bool), coordinates)
        factors = self.factors
        if noise > 0.0:
            effect = noise * self._effect_of_noise()
            factors = np.linalg.cholesky(factors @ np.swapaxes(factors, -1, -2) + effect @ effect.T)
        return conditional_mixture(self.weights, self.means, factors, self.observed, coordinates)

    def _effect_of_noise(self) -> Float[np.ndarray, "d n"]:
        """What errors of the observed positions do to a window's coordinates: all are relative to the newest one."""
        others = np.eye(self.observations + self.steps, self.observations)
        others[self.observations :] = 0.0
        relative = np.delete(others, self.observations - 1, axis=0) - others[self.observations - 1]
        anchor = others[self.observations - 1 : self.observations] if self.bounds is not None else others[:0]
        return np.kron(np.concatenate([anchor, relative]), np.eye(3))


def window_coordinates(
    windows: Float[np.ndarray, "*n l 3"], observations: int, anchored: bool
) -> Float[np.ndarray, "*n d"]:
    """The coordinates [m] of windows, or of only their observed part; ``anchored`` keeps the newest position."""
    newest = windows[..., observations - 1, :]
    others = np.delete(windows, observations - 1, axis=-2) - newest[..., None, :]
    relative = others.reshape(*windows.shape[:-2], -1)
    return np.concatenate([newest, relative], axis=-1) if anchored else relative


def save_model(model: TargetModel, path: Path, origin: dict[str, Any]) -> None:
    """Write ``path`` (.npy) and its card (.json), in which ``origin`` says where the model comes from.

    Each is there whole or not at all; a new array beside an old card is refused by its hash.
    """
    rows, columns = np.tril_indices(model.means.shape[1])
    table = np.concatenate([model.weights[:, None], model.means, model.factors[:, rows, columns]], axis=1)
    buffer = io.BytesIO()
    np.save(buffer, np.ascontiguousarray(table, dtype="<f4"))
    card = {
        "format": FORMAT,
        "name": model.name,
        "components": len(model.weights),
        "observations": model.observations,
        "steps": model.steps,
        "dt": model.dt,
        "bounds": None if model.bounds is None else np.asarray(model.bounds).tolist(),
        "sha256": hashlib.sha256(buffer.getvalue()).hexdigest(),
        **origin,
    }
    write_atomically(path, buffer.getvalue())
    write_atomically(card_path(path), json.dumps(card, indent=1) + "\n")


def card_path(path: Path) -> Path:
    """The card of the model in ``path``."""
    return path.with_suffix(".json")


def load_model(path: str | Path) -> TargetModel:
    """Read a model and check all of it; raises FileError for what is missing, damaged or of another version."""
    path = Path(path)
    data = read_limited(path, _LARGEST_FILE, _WANTED)
    card = _read_card(card_path(path))
    if hashlib.sha256(data).hexdigest() != card["sha256"]:
        raise FileError(f"{path}: its content is not what {card_path(path).name} vouches for; copy or train it again")
    observed = card["observations"] - 1 + (card["bounds"] is not None)
    size = 3 * (observed + card["steps"])
    wanted = (card["components"], 1 + size + size * (size + 1) // 2)
    table = _read_table(path, data, wanted)
    rows, columns = np.tril_indices(size)
    factors = np.zeros((len(table), size, size))
    factors[:, rows, columns] = table[:, 1 + size :]
    weights, diagonal = table[:, 0], np.diagonal(factors, axis1=1, axis2=2)
    if not (np.isfinite(table).all() and (weights > 0.0).all() and abs(weights.sum() - 1.0) < 1e-3):
        raise FileError(f"{path}: has values that are not finite, or weights that do not sum to 1; train it again")
    if not (diagonal > 0.0).all():
        raise FileError(f"{path}: has a covariance factor whose diagonal is not positive; train it again")
    return TargetModel(
        name=card["name"],
        observations=card["observations"],
        steps=card["steps"],
        dt=float(card["dt"]),
        bounds=None if card["bounds"] is None else np.array(card["bounds"], dtype=float),
        weights=weights / weights.sum(),
        means=table[:, 1 : 1 + size],
        factors=factors,
    )


def shipped_model(world: str, dt: float) -> TargetModel:
    """The model that comes with a stored world, or the generic one for predictions ``dt`` [s] apart.

    Raises:
        InputError: no generic model was trained for this interval.
    """
    stored = {path.stem: path for path in _SHIPPED.glob("*.npy")}
    if world in stored and _read_card(card_path(stored[world]))["dt"] == dt:
        return load_model(stored[world])
    generic = f"{GENERIC}-{round(1e3 * dt)}ms"
    if generic not in stored:
        known = ", ".join(sorted(stored))
        raise InputError(f"prediction: no target model for dt = {dt} s, have {known}; train one: jaxplan train gmm")
    return load_model(stored[generic])


def check_model(model: TargetModel, *, observations: int, steps: int, dt: float, world: World | None) -> None:
    """Raise InputError unless the model's windows are those that will be asked of it."""
    for name, have, want in (
        ("observations", model.observations, observations),
        ("steps", model.steps, steps),
        ("dt", model.dt, dt),
    ):
        if have != want:
            raise InputError(f"target model {model.name!r}: has {name} = {have}, want {want}; train one that fits")
    if model.bounds is not None and world is not None:
        room = np.asarray(world.bounds, dtype=float)
        if not np.allclose(model.bounds, room, rtol=0.0, atol=_SAME_BOUNDS):
            raise InputError(
                f"target model {model.name!r}: belongs to a room from {model.bounds[0].tolist()} to "
                f"{model.bounds[1].tolist()} m, world {world.name!r} is another; use the generic model or train one"
            )


def _read_card(path: Path) -> dict[str, Any]:
    data = read_limited(path, _LARGEST_CARD, _WANTED)
    try:
        card = json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: is no JSON ({' '.join(str(error).split())[:80]}); copy or train it again") from error
    if not isinstance(card, dict) or card.get("format") != FORMAT:
        have = card.get("format") if isinstance(card, dict) else None
        raise FileError(f"{path}: has the format {have!r}, want {FORMAT!r}; train the model again with this version")
    counts = (card.get("components"), card.get("observations"), card.get("steps"))
    if not all(isinstance(count, int) and not isinstance(count, bool) and 0 < count < 1000 for count in counts):
        raise FileError(f"{path}: components, observations or steps are not counts; copy or train it again")
    if not (isinstance(card.get("dt"), int | float) and 0.0 < card["dt"] < 60.0):
        raise FileError(f"{path}: dt is {card.get('dt')!r}, want seconds; copy or train it again")
    if "bounds" not in card or (card["bounds"] is not None and not _is_box(card["bounds"])):
        raise FileError(
            f"{path}: bounds are {card.get('bounds')!r}, want two corners in metres; copy or train it again"
        )
    if not isinstance(card.get("sha256"), str) or not isinstance(card.get("name"), str):
        raise FileError(f"{path}: sha256 or name is missing; copy or train it again")
    return card


def _is_box(value: Any) -> bool:
    """Whether this is two corners of three finite numbers."""
    if not (isinstance(value, list) and len(value) == 2 and all(isinstance(c, list) and len(c) == 3 for c in value)):
        return False
    numbers = [number for corner in value for number in corner]
    return all(isinstance(number, int | float) and np.isfinite(number) for number in numbers)


def _read_table(path: Path, data: bytes, wanted: tuple[int, int]) -> Float[np.ndarray, "k n"]:
    try:
        table = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, EOFError, SyntaxError, OSError) as error:
        raise FileError(f"{path}: is no NumPy array ({' '.join(str(error).split())[:80]}); train it again") from error
    if not isinstance(table, np.ndarray) or table.shape != wanted or table.dtype != np.dtype("<f4"):
        have = f"{table.dtype} of shape {table.shape}" if isinstance(table, np.ndarray) else "an archive"
        raise FileError(f"{path}: have {have}, want float32 of shape {wanted} as its card says; train it again")
    return table.astype(np.float64)
