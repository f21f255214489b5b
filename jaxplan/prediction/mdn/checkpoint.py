"""Weights of the network as one file (``jaxplan.weights``), and whether they still foretell what they foretold."""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError
from jaxplan.names import SHIPPED
from jaxplan.prediction.mdn.curves import CURVES, Curves, flights_of
from jaxplan.prediction.mdn.network import NetworkConfig, mixture_of
from jaxplan.prediction.mdn.view import OBSERVATIONS, PROBES, STEPS, View
from jaxplan.weights import read_weights, resolve_weights, unflatten, write_weights

KIND = "flight network"
WEIGHTS = SHIPPED[KIND]
SHIPPED_NETWORK = "rooms"
GOLDEN_TOLERANCE = 1e-3
"""Largest deviation of the golden flights, in units of length: above any rounding of float32."""


class TrainedNetwork(NamedTuple):
    """What a file of weights holds."""

    network: NetworkConfig
    parameters: dict[str, Any]
    """NumPy, float32."""
    curves: Curves
    intervals: tuple[float, ...]
    """Seconds between positions that it was trained with."""


def save_network(path: Path, trained: TrainedNetwork, card: dict[str, Any]) -> None:
    """Write weights with their model ``card``: how they were made and how they score."""
    header = {
        "network": dataclasses.asdict(trained.network),
        "intervals": list(trained.intervals),
        "golden": _golden(trained).tolist(),
        "card": card,
    }
    write_weights(path, KIND, header, {"network": trained.parameters, "curves": trained.curves._asdict()})


def load_network(source: str | Path = SHIPPED_NETWORK) -> TrainedNetwork:
    """The network in a file of ``jaxplan train mdn``, or a shipped one by name (``rooms``).

    Raises:
        FileError: no such file or name; damaged; of another format; weights that do not give the golden flights.
    """
    path, _ = resolve_weights(source, WEIGHTS, KIND)
    header, arrays = read_weights(path, KIND)
    try:
        tree = unflatten(arrays)
        shapes, spreads = tree["curves"]["shapes"], tree["curves"]["spreads"]
        if shapes.shape != (STEPS, CURVES) or spreads.shape != (3, CURVES):
            raise ValueError(f"curves of shape {shapes.shape}")
        intervals = tuple(float(interval) for interval in header["intervals"])
        trained = TrainedNetwork(
            NetworkConfig(**header["network"]), tree["network"], Curves(shapes, spreads), intervals
        )
        golden, found = np.asarray(header["golden"], float), _golden(trained)
    except Exception as error:  # whatever NumPy says of foreign weights
        raise FileError(
            f"{path}: does not hold a {KIND}'s weights ({error}); use a file of jaxplan train mdn"
        ) from error
    if found.shape != golden.shape or not np.allclose(found, golden, rtol=0.0, atol=GOLDEN_TOLERANCE):
        raise FileError(f"{path}: the weights do not give the flights that they gave when they were saved")
    return trained


def network_card(source: str | Path = SHIPPED_NETWORK) -> dict[str, Any]:
    """How a network was made and how it scored."""
    return dict(read_weights(resolve_weights(source, WEIGHTS, KIND)[0], KIND)[0]["card"])


def _golden(trained: TrainedNetwork) -> Float[np.ndarray, "3 g"]:
    """Where the expected flights of three fixed views end, and the sums of all that says how certain that is."""
    rng = np.random.default_rng(7)
    view = View(
        relative=(0.05 * np.cumsum(rng.normal(size=(3, OBSERVATIONS - 1, 3)), axis=1)[:, ::-1]).astype(np.float32),
        seen=np.ones((3, OBSERVATIONS - 1), np.float32),
        scale=np.array([1.0, 5.0, 20.0], np.float32),
        interval=np.array([0.1, 0.1, 0.2], np.float32),
        room=rng.uniform(-0.5, 2.0, (3, len(PROBES))).astype(np.float32),
    )
    mixture = mixture_of(trained.parameters, view, np)
    expected = (np.exp(mixture.log_weights)[..., None] * mixture.means).sum(axis=1)
    ends = flights_of(trained.curves, expected)[:, -1]
    spreads = [np.mean(part, axis=(1, 2)) for part in (mixture.log_precisions, mixture.couplings)]
    return np.concatenate([ends, mixture.log_weights, np.stack(spreads, axis=1)], axis=1).astype(float)
