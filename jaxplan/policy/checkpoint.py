"""Weights of a policy as one file, and whether they are what they claim to be.

A checkpoint is an ``.npz`` of plain arrays with a JSON header: format, network sizes, names, shapes and hash of the
weights, the command and scores that made them, and a golden input with its durations. Loading checks all of it, so a
file that is damaged, of another version or of another network is refused by name instead of flying.
"""

import hashlib
import io
import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError
from jaxplan.policy.network import NetworkConfig
from jaxplan.policy.neural import neural_policy
from jaxplan.policy.protocol import Policy
from jaxplan.spline import FlatState

FORMAT = 1
GOLDEN_TOLERANCE = 1e-3
"""Largest relative deviation of the golden durations: above any rounding of float32, far below any wrong weight."""
WEIGHTS = Path(__file__).parent / "weights"
LARGEST = 64 * 2**20
"""Bytes; a larger file is not one of ours."""


def save_policy(path: Path, config: NetworkConfig, parameters: Any, card: dict[str, Any]) -> None:
    """Write weights with their model ``card``: how they were made and how they score."""
    arrays = _flatten(parameters)
    header = {
        "format": FORMAT,
        "network": {"hidden": config.hidden, "attention": config.attention, "latent": config.latent},
        "sha256": _digest(arrays),
        "golden": _golden(config, parameters).tolist(),
        "card": card,
    }
    packed = io.BytesIO()
    np.savez(packed, allow_pickle=False, header=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)
    path.write_bytes(packed.getvalue())


def load_policy(source: str | Path) -> Policy:
    """The policy in a checkpoint file, or a shipped one by name (``pretrained``).

    Raises:
        FileError: no such file or name; damaged; of another format; weights that do not give the golden durations.
    """
    path, name = resolve_policy(source)
    header, arrays = _read(path)
    try:
        config = NetworkConfig(**header["network"])
        wanted, golden = header["sha256"], np.asarray(header["golden"], float)
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(f"{path}: its header is not a policy's ({error}); use a file of jaxplan") from error
    if _digest(arrays) != wanted:
        raise FileError(f"{path}: the weights do not have the hash that the header states; the file is damaged")
    parameters = _unflatten(arrays)
    try:
        found = _golden(config, parameters)
    except Exception as error:  # whatever a network says of foreign weights
        raise FileError(f"{path}: the weights do not fit their network; the file is damaged") from error
    if found.shape != golden.shape or not np.allclose(found, golden, rtol=GOLDEN_TOLERANCE, atol=0.0):
        raise FileError(f"{path}: the weights do not give the durations that they gave when they were saved")
    return neural_policy(name, config, jax.tree.map(jnp.asarray, parameters))


def policy_card(source: str | Path) -> dict[str, Any]:
    """How a policy was made and how it scored."""
    return _read(resolve_policy(source)[0])[0]["card"]


def resolve_policy(source: str | Path) -> tuple[Path, str]:
    """File and name of a policy: a shipped one by name, or a file."""
    shipped = WEIGHTS / f"{source}.npz"
    if shipped.is_file():
        return shipped, str(source)
    path = Path(source)
    if path.is_file():
        return path, path.stem
    names = ", ".join(sorted(file.stem for file in WEIGHTS.glob("*.npz"))) or "none"
    raise FileError(f"policy {str(source)!r}: neither a file nor a shipped policy ({names}); correct the name")


def _read(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    if path.stat().st_size > LARGEST:
        raise FileError(f"{path}: has {path.stat().st_size} bytes, want a policy of at most {LARGEST}")
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as data:
            arrays = {key: data[key] for key in data.files}
        header = json.loads(arrays.pop("header").tobytes())
        version = header["format"]
    except Exception as error:  # zip, JSON, key, ... : a damaged file can fail anywhere
        raise FileError(f"{path}: cannot be read as a policy; the file is damaged or something else") from error
    if version != FORMAT:
        raise FileError(f"{path}: has format {version}, want {FORMAT}; use weights made for this version of jaxplan")
    return header, arrays


def _golden(config: NetworkConfig, parameters: Any) -> Float[np.ndarray, "m 3"]:
    """Durations for three fixed sequences and states."""
    rng = np.random.default_rng(7)
    waypoints = np.cumsum(rng.uniform(-1.0, 2.0, (14, 3, 3)), axis=0)
    count = np.array([2, 7, 14])
    for lane, last in enumerate(count - 1):
        waypoints[last:, :, lane] = waypoints[last, :, lane]
    derivatives, yaw = rng.normal(size=(5, 3, 3)) * np.array([0.0, 2.0, 5.0]), rng.normal(size=(3, 3))
    initial = FlatState(derivatives=jnp.asarray(derivatives), yaw=jnp.asarray(yaw))
    policy = neural_policy("golden", config, jax.tree.map(jnp.asarray, parameters))
    durations = policy.decode(policy.encode(jnp.asarray(waypoints), jnp.asarray(count)), initial)
    return np.asarray(durations, dtype=float)


def _flatten(parameters: Any) -> dict[str, np.ndarray]:
    leaves = jax.tree_util.tree_leaves_with_path(parameters)
    return {"/".join(str(key.key) for key in path): np.asarray(leaf, np.float32) for path, leaf in leaves}


def _unflatten(arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for name, array in arrays.items():
        *folders, last = name.split("/")
        place = tree
        for folder in folders:
            place = place.setdefault(folder, {})
        place[last] = array
    return tree


def _digest(arrays: dict[str, np.ndarray]) -> str:
    """Hash of names, shapes and contents."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        found.update(f"{name} {arrays[name].shape} {arrays[name].dtype}".encode())
        found.update(np.ascontiguousarray(arrays[name]).tobytes())
    return found.hexdigest()
