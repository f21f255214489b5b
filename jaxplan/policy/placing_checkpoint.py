"""Weights of a placing policy as one file (``jaxplan.weights``), and whether they still place as they placed."""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError
from jaxplan.names import SHIPPED
from jaxplan.policy.network import NetworkConfig
from jaxplan.policy.placing import SEGMENTS, VEHICLE_NUMBERS, Courses, Place, placing_policy
from jaxplan.spline import FlatStateBatch
from jaxplan.weights import read_weights, resolve_weights, unflatten, write_weights

KIND = "placing policy"
WEIGHTS = SHIPPED[KIND]
GOLDEN_TOLERANCE = 1e-3
"""Largest deviation of the golden plans [s, m]: above any rounding of float32, far below any wrong weight."""


class TrainedPlacing(NamedTuple):
    """What a file of weights holds: enough to go on training from."""

    network: NetworkConfig
    parameters: Any
    """A tree as Flax has it, float32."""


def save_placing(path: Path, config: NetworkConfig, parameters: Any, card: dict[str, Any]) -> None:
    """Write weights with their model ``card``: how they were made and how they score."""
    header = {"network": dataclasses.asdict(config), "golden": _golden(config, parameters).tolist(), "card": card}
    write_weights(path, KIND, header, parameters)


def load_placing(source: str | Path) -> Place:
    """The placing policy in a file of ``jaxplan train placing``, or a shipped one by name (``fleet``).

    It serves every vehicle.

    Raises:
        FileError: no such file or name; damaged; of another format; weights that do not give the golden plans.
    """
    trained = load_placing_parameters(source)
    return placing_policy(trained.network, trained.parameters)


def load_placing_parameters(source: str | Path) -> TrainedPlacing:
    """Sizes and weights, to go on training from; checked as by ``load_placing``."""
    path, _ = resolve_weights(source, WEIGHTS, KIND)
    header, arrays = read_weights(path, KIND)
    try:
        config = NetworkConfig(**header["network"])
        golden = np.asarray(header["golden"], float)
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(f"{path}: its header is not a {KIND}'s ({error}); use a file of jaxplan") from error
    parameters = unflatten(arrays)
    try:
        found = _golden(config, parameters)
    except Exception as error:  # whatever a network says of foreign weights
        raise FileError(f"{path}: the weights do not fit their network; the file is damaged") from error
    if found.shape != golden.shape or not np.allclose(found, golden, rtol=0.0, atol=GOLDEN_TOLERANCE):
        raise FileError(f"{path}: the weights do not give the plans that they gave when they were saved")
    return TrainedPlacing(config, jax.tree.map(jnp.asarray, parameters))


def placing_card(source: str | Path) -> dict[str, Any]:
    """How a placing policy was made and how it scored."""
    return read_weights(resolve_weights(source, WEIGHTS, KIND)[0], KIND)[0]["card"]


def _golden(config: NetworkConfig, parameters: Any) -> Float[np.ndarray, "r 3"]:
    """Durations and places for three fixed courses and states."""
    rng = np.random.default_rng(7)
    points = np.cumsum(rng.uniform(-0.5, 1.5, (SEGMENTS + 1, 3, 3)), axis=0)
    room = rng.uniform(0.2, 2.0, (2 * SEGMENTS, 4, 3))
    radius, numbers = np.array([0.3, 0.1, 0.02]), 0.3 * rng.normal(size=(VEHICLE_NUMBERS, 3))
    derivatives = rng.normal(size=(5, 3, 3)) * np.array([0.0, 2.0, 4.0, 10.0, 30.0])[:, None, None]
    derivatives[0] = points[0]
    initial = FlatStateBatch(derivatives=derivatives, yaw=np.zeros((3, 3)) + rng.normal(size=3) * [[1.0], [0.0], [0.0]])
    placed = jax.jit(placing_policy(config, parameters))(Courses(points, room, radius, numbers), initial)
    return np.concatenate([placed.durations, np.asarray(placed.points).reshape(-1, 3)]).astype(float)
