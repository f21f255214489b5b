"""A classifier as one file (``jaxplan.weights``), and whether it still gives the probabilities that it gave."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError
from jaxplan.feasibility.classifier import Classifier, Model, make_classifier, new_model
from jaxplan.feasibility.features import INSTANTS, MOTION_FEATURES
from jaxplan.kept import kept
from jaxplan.vehicle.identity import from_header, to_header
from jaxplan.vehicle.params import Vehicle
from jaxplan.weights import read_weights, resolve_weights, restore, write_weights

KIND = "classifier"
GOLDEN_TOLERANCE = 1e-2
"""Largest deviation of the golden probabilities."""
WEIGHTS = Path(__file__).parent / "weights"


def save_classifier(path: Path, model: Model, card: dict[str, Any], *, vehicle: Vehicle) -> None:
    """Write a model with its ``card`` (how it was made and how it scores) and the vehicle that it is for."""
    header = {
        "inducing": len(model.process.inducing),
        "vehicle": to_header(vehicle),
        "golden": _golden(make_classifier(model)).tolist(),
        "card": card,
    }
    write_weights(path, KIND, header, model)


def load_classifier(source: str | Path) -> Classifier:
    """The classifier in a file, or a shipped one by name (``mfrl``).

    It serves the vehicle that it was trained for, and ``build_planner`` refuses others; a file from before headers said
    so counts as made for the preset ``mfrl``. ``Classifier.predict`` says of trajectories whether they can be tracked.

    Raises:
        FileError: no such file or name; damaged; of another format; a model that does not give the golden
            probabilities.
    """
    path, _ = resolve_weights(source, WEIGHTS, KIND)
    header, arrays = read_weights(path, KIND)
    try:
        inducing, golden = int(header["inducing"]), np.asarray(header["golden"], float)
        vehicle = from_header(header)
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(f"{path}: its header is not a classifier's ({error}); use a file of jaxplan") from error
    template = jax.eval_shape(lambda: new_model(inducing, 0, jnp.zeros((MOTION_FEATURES, INSTANTS, 1), jnp.float32)))
    classifier = make_classifier(jax.tree.map(jnp.asarray, restore(template, arrays)), vehicle)
    found = _golden(classifier)
    if found.shape != golden.shape or not np.allclose(found, golden, rtol=0.0, atol=GOLDEN_TOLERANCE):
        raise FileError(f"{path}: the model does not give the probabilities that it gave when it was saved")
    return classifier


def classifier_card(source: str | Path) -> dict[str, Any]:
    """How a classifier was made and how it scored."""
    return read_weights(resolve_weights(source, WEIGHTS, KIND)[0], KIND)[0]["card"]


def _golden(classifier: Classifier) -> Float[np.ndarray, "k"]:
    """Probabilities for eight fixed motions."""
    motion = np.random.default_rng(7).normal(size=(8, INSTANTS, MOTION_FEATURES)).astype(np.float32).T
    return np.asarray(kept(classifier.predict_motion)(motion).probability, float)
