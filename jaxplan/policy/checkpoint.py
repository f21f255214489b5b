"""Weights of a policy as one file (``jaxplan.weights``), and whether they still give the durations that they gave.

The header adds the network's sizes, the vehicle that the weights were made for, the command and scores that made them,
and the durations of three golden sequences. Loading checks all of it, so weights of another network are refused by name
instead of flying.
"""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplan.errors import FileError
from jaxplan.kept import kept
from jaxplan.policy.network import NetworkConfig
from jaxplan.policy.neural import neural_policy
from jaxplan.policy.protocol import Policy
from jaxplan.spline import FlatStateBatch
from jaxplan.vehicle.identity import VehicleId, from_header, to_header
from jaxplan.vehicle.params import Vehicle
from jaxplan.weights import read_weights, resolve_weights, unflatten, write_weights

KIND = "policy"
GOLDEN_TOLERANCE = 1e-3
"""Largest relative deviation of the golden durations: above any rounding of float32, far below any wrong weight."""
WEIGHTS = Path(__file__).parent / "weights"


class TrainedPolicy(NamedTuple):
    """What a file of weights holds: enough to go on training from."""

    network: NetworkConfig
    parameters: Any
    """A tree as Flax has it, float32."""
    vehicle: VehicleId
    """For which they were trained."""


def save_policy(path: Path, config: NetworkConfig, parameters: Any, card: dict[str, Any], *, vehicle: Vehicle) -> None:
    """Write weights with their model ``card`` (how they were made and how they score) and the vehicle they are for."""
    header = {
        "network": {"hidden": config.hidden, "attention": config.attention, "latent": config.latent},
        "vehicle": to_header(vehicle),
        "golden": _golden(config, parameters).tolist(),
        "card": card,
    }
    write_weights(path, KIND, header, parameters)


def load_policy(source: str | Path) -> Policy:
    """The policy in a checkpoint file, or a shipped one by name (``mfrl``, ``pretrained``).

    It serves the vehicle that it was trained for, and ``build_planner`` refuses others; a file from before headers said
    so counts as made for the preset ``mfrl``.

    Raises:
        FileError: no such file or name; damaged; of another format; weights that do not give the golden durations.
    """
    return neural_policy(resolve_policy(source)[1], *load_parameters(source))


def load_parameters(source: str | Path) -> TrainedPolicy:
    """Sizes and weights of a policy, to go on training from; checked as by ``load_policy``."""
    path, _ = resolve_policy(source)
    header, arrays = read_weights(path, KIND)
    try:
        config = NetworkConfig(**header["network"])
        golden, vehicle = np.asarray(header["golden"], float), from_header(header)
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(f"{path}: its header is not a policy's ({error}); use a file of jaxplan") from error
    parameters = unflatten(arrays)
    try:
        found = _golden(config, parameters)
    except Exception as error:  # whatever a network says of foreign weights
        raise FileError(f"{path}: the weights do not fit their network; the file is damaged") from error
    if found.shape != golden.shape or not np.allclose(found, golden, rtol=GOLDEN_TOLERANCE, atol=0.0):
        raise FileError(f"{path}: the weights do not give the durations that they gave when they were saved")
    return TrainedPolicy(config, jax.tree.map(jnp.asarray, parameters), vehicle)


def policy_vehicle(source: str | Path) -> VehicleId:
    """For which vehicle a policy was trained, from its header alone; ``FileError`` as ``load_policy``."""
    path, _ = resolve_policy(source)
    header, _ = read_weights(path, KIND)
    try:
        return from_header(header)
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(f"{path}: its header is not a policy's ({error}); use a file of jaxplan") from error


def policy_card(source: str | Path) -> dict[str, Any]:
    """How a policy was made and how it scored."""
    return read_weights(resolve_policy(source)[0], KIND)[0]["card"]


def resolve_policy(source: str | Path) -> tuple[Path, str]:
    """File and name of a policy: a shipped one by name, or a file."""
    return resolve_weights(source, WEIGHTS, KIND)


def _golden(config: NetworkConfig, parameters: Any) -> Float[np.ndarray, "m 3"]:
    """Durations for three fixed sequences and states."""
    rng = np.random.default_rng(7)
    waypoints = np.cumsum(rng.uniform(-1.0, 2.0, (14, 3, 3)), axis=0)
    count = np.array([2, 7, 14])
    for lane, last in enumerate(count - 1):
        waypoints[last:, :, lane] = waypoints[last, :, lane]
    derivatives, yaw = rng.normal(size=(5, 3, 3)) * np.array([0.0, 2.0, 5.0]), rng.normal(size=(3, 3))
    initial = FlatStateBatch(derivatives=derivatives, yaw=yaw)
    allocate = kept(_allocate, static=1)
    return np.asarray(allocate(config, parameters, waypoints, count, initial), dtype=float)


def _allocate(
    config: NetworkConfig,
    parameters: Any,
    waypoints: Float[Array, "n 3 k"],
    count: Int[Array, "k"],
    initial: FlatStateBatch,
) -> Float[Array, "m k"]:
    """The durations [s] that a network with these weights allots (traced)."""
    policy = neural_policy("golden", config, parameters)
    return policy.decode(policy.encode(waypoints, count), initial)
