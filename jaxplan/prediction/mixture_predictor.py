"""Prediction by a mixture: conditioned on what was seen, drawn from and scored, in one compiled program."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.precision import in_float64
from jaxplan.prediction.kinematic import constant_velocity
from jaxplan.prediction.mixture import ConditionalMixture, Prediction, condition, draw, draw_randoms, log_density
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.protocol import Draws, PredictionConfig, Proposal, Proposer
from jaxplan.prediction.target_model import TargetModel, check_model, window_coordinates
from jaxplan.status import Note
from jaxplan.world.obstacles import World

_UNUSUAL = 10.0
"""Squared Mahalanobis distance per observed coordinate above which a window is unlike all that a mixture knows."""
_EVEN = 1e-6
"""Seconds by which the spacing of observations may differ from ``dt``."""


def mixture_proposer(config: PredictionConfig, model: TargetModel, world: World | None) -> Proposer:
    """Where the conditional mixture says; constant velocity where too little was seen, or nothing like it in training.

    Raises InputError where the model is for other windows than those of ``config``, or for another room.
    """
    check_model(model, observations=config.observations, steps=config.steps, dt=config.dt, world=world)
    mixture = model.conditional()
    on_device = in_float64(jax.device_put)(mixture)
    anchored, offsets, unusual = model.bounds is not None, config.offsets, model.observed * _UNUSUAL

    @in_float64
    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        if not _complete(observations, config):
            return Proposal(constant_velocity(observations, offsets), None, Note.PREDICTOR_FALLBACK)
        newest = observations.positions[-1]
        observed = window_coordinates(observations.positions, config.observations, anchored)
        uniform, normal = draw_randoms(config.steps, config.batch, rng)
        randoms = np.concatenate([uniform[..., None], normal], axis=-1)
        log_weights, means, scored, distance = conditional_draw(on_device, np.append(newest, observed), randoms)
        if not float(distance) <= unusual:
            return Proposal(constant_velocity(observations, offsets), None, Note.PREDICTOR_FALLBACK)
        prediction = Prediction(offsets=offsets, log_weights=log_weights, means=means, factors=mixture.factors)
        drawn = np.asarray(scored)
        return Proposal(prediction, Draws(drawn[..., :3], drawn[..., 3]))

    return propose


@jax.jit
def conditional_draw(
    model: ConditionalMixture, seen: Float[Array, "p"], randoms: Float[Array, "s b 4"]
) -> tuple[Float[Array, "k"], Float[Array, "s 3 k"], Float[Array, "s b 4"], Float[Array, ""]]:
    """Condition, draw and score in one program. Few arguments and results: each costs some 15 us to hand over.

    Args:
        model: with its first q coordinates to be observed.
        seen: the newest position [m, world], and behind it what is observed: p = 3 + q.
        randoms: for each draw a uniform number in [0, 1) and three standard normal ones.

    Returns:
        log-weights; means [m, world]; positions [m, world] with the logarithms of their densities [log 1/m^3] behind
        them; the squared Mahalanobis distance of what is observed from the nearest component.
    """
    log_weights, means, distance = condition(model, seen[3:])
    means = means + seen[None, :3, None]
    goals = draw(log_weights, means, model.factors, randoms[..., 0], randoms[..., 1:])
    densities = log_density(log_weights, means, model.inverses, model.log_volumes, goals)
    return log_weights, means, jnp.concatenate([goals, densities[..., None]], axis=-1), distance


def _complete(observations: Observations, config: PredictionConfig) -> bool:
    """Whether these are N_obs positions at the intervals that a model was trained on."""
    if len(observations.times) != config.observations:
        return False
    return bool(np.abs(np.diff(observations.times) - config.dt).max(initial=0.0) < _EVEN)
