"""Rollout labels for a policy's flights, spent where the classifier is least sure.

The variation ratio 1 - max(P, 1 - P) is largest where P is 1/2 (MFRL, Sec. III). Labels are kept and replayed; both
classes stay common because flights are tried from too fast to comfortably slow.
"""

import math
import zipfile
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplan.errors import FileError
from jaxplan.feasibility.classifier import Classifier, Model
from jaxplan.feasibility.features import motion_features
from jaxplan.feasibility.gaussian_process import marginals
from jaxplan.files import LARGEST_ARCHIVE, read_arrays, read_limited, write_atomically
from jaxplan.minsnap.spline_batch import SplineBatch
from jaxplan.precision import in_float64
from jaxplan.tracking.track import track
from jaxplan.training.classifier import Labelled
from jaxplan.training.dataset import build_flights
from jaxplan.training.labels import LabelConfig, Queries
from jaxplan.training.sequences import take
from jaxplan.vehicle.params import Vehicle

WIDTH = 512
"""Flights that are solved together."""


class Flights(NamedTuple):
    """Solved flights and what the classifier sees of them."""

    splines: SplineBatch
    motion: Float[np.ndarray, "f p n"]


@runtime_checkable
class Solve(Protocol):
    """Flights of given durations."""

    def __call__(self, queries: Queries, durations: Float[np.ndarray, "m n"]) -> Flights:
        """Solve n sequences with these durations [s] (host)."""


def build_solve(vehicle: Vehicle, labels: LabelConfig) -> Solve:
    """Flights of given durations, ``WIDTH`` at a time."""
    fly = build_flights(labels)
    look = in_float64(jax.jit(motion_features))

    def solve(queries: Queries, durations: Float[np.ndarray, "m n"]) -> Flights:
        size, parts = durations.shape[-1], []
        for begin in range(0, size, WIDTH):
            some = np.minimum(np.arange(begin, begin + WIDTH), size - 1)
            splines = fly(take(queries, some), durations[:, some])
            parts.append(Flights(splines, np.asarray(look(splines, vehicle))))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves, axis=-1)[..., :size], *parts)

    return solve


def perturbed(
    durations: Float[np.ndarray, "m n"], span: tuple[float, float], noise: float, rng: np.random.Generator
) -> Float[np.ndarray, "m n"]:
    """Durations with noise on each logarithm, and all of a flight's together by a factor within ``span``."""
    factor = np.exp(rng.uniform(math.log(span[0]), math.log(span[1]), durations.shape[-1]))
    return durations * factor * np.exp(noise * rng.normal(size=durations.shape))


def roll_out(flights: Flights, members: Int[np.ndarray, "n"], vehicle: Vehicle, seed: int) -> Bool[np.ndarray, "n"]:
    """Whether a rollout tracks some of the flights, ``members`` by their index, with noise from ``seed`` (host)."""
    some = jax.tree.map(lambda leaf: np.asarray(leaf)[..., members], flights.splines)
    streams = seed * 1_000_000 + np.arange(len(members))
    return np.asarray(track(some, vehicle=vehicle, indices=streams % 2**31).feasible)


def least_certain(probability: Float[np.ndarray, "n"], count: int) -> Int[np.ndarray, "c"]:
    """The flights of the largest variation ratio."""
    ratio = 1.0 - np.maximum(probability, 1.0 - probability)
    return np.argsort(-ratio, kind="stable")[:count]


def probabilities(classifier: Classifier, motion: Float[np.ndarray, "f p n"]) -> Float[np.ndarray, "n"]:
    """P(tracked) of many flights from their ``motion_features``, ``WIDTH`` at a time (host)."""
    size = motion.shape[-1]
    filled = np.resize(np.arange(size), -(-size // WIDTH) * WIDTH)
    parts = [_probability(classifier, jnp.asarray(motion[..., k])) for k in np.split(filled, len(filled) // WIDTH)]
    return np.concatenate([np.asarray(part) for part in parts])[:size]


@jax.jit
def _probability(classifier: Classifier, motion: Float[Array, "f p n"]) -> Float[Array, "n"]:
    return classifier.predict_motion(motion).probability


def latents(model: Model, motion: Float[np.ndarray, "f p n"]) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Mean and variance of the latent function for many flights (host)."""
    find = jax.jit(lambda some: marginals(model.process, model.inputs(some)))
    parts = [find(jnp.asarray(part)) for part in np.array_split(motion, -(-motion.shape[-1] // WIDTH), axis=-1)]
    mean, variance = (np.concatenate(leaves) for leaves in zip(*parts, strict=True))
    return mean, variance


def save_labels(path: Path, labelled: Labelled) -> None:
    """One round's labels."""
    write_atomically(path, lambda staged: np.savez(staged, motion=labelled.motion, feasible=labelled.feasible))


def load_labels(paths: list[Path]) -> Labelled:
    """All rounds' labels."""
    rounds = []
    for path in paths:
        try:
            data = read_arrays(read_limited(path, LARGEST_ARCHIVE, "a round of labels"))
            rounds.append(Labelled(data["motion"], data["feasible"]))
        except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise FileError(f"{path}: is not a round of labels ({error}); remove it to make it again") from error
    return Labelled(*(np.concatenate(column, axis=-1) for column in zip(*rounds, strict=True)))
