"""Prediction by a mixture: conditioned on what was seen, drawn from and scored, in one compiled program."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplan.precision import in_float64
from jaxplan.prediction.kinematic import constant_velocity
from jaxplan.prediction.mixture import ConditionalMixture, Prediction, condition, draw, draw_randoms, log_density
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.protocol import Draws, PredictionConfig, Proposal, Proposer, window_of
from jaxplan.prediction.target_model import TargetModel, check_model, window_coordinates
from jaxplan.status import Note
from jaxplan.world.obstacles import World

LEAST_SEEN = 2
"""Positions from which on a mixture is asked: with one nothing is known of the velocity."""
UNUSUAL = 10.0
"""Squared Mahalanobis distance per observed coordinate above which a window is unlike all that a mixture knows."""


class WindowMixture:
    """A mixture for windows of which only the newest positions may have been seen, on the device or in NumPy.

    Positions may have more noise than the mixture learned with: it is made ready for each amount when it is first asked
    with so much, which takes some 20 ms.
    """

    def __init__(
        self, config: PredictionConfig, model: TargetModel, world: World | None, on_device: bool = True
    ) -> None:
        """Raises InputError where the model is for other windows than those of ``config``, or for another room."""
        self._on_device = on_device
        check_model(model, observations=config.observations, steps=config.steps, dt=config.dt, world=world)
        self._config, self._model, self._anchored = config, model, model.bounds is not None
        self._mixtures: dict[tuple[int, float], ConditionalMixture] = {}
        for seen in range(LEAST_SEEN, config.observations + 1):
            self._mixture(seen, 0.0)

    def _mixture(self, seen: int, noise: float) -> ConditionalMixture:
        if (seen, noise) not in self._mixtures:
            ready = self._model.conditional(seen, noise)
            here = jax.tree.map(lambda leaf: np.array(leaf, float, order="C"), ready)
            self._mixtures[seen, noise] = in_float64(jax.device_put)(ready) if self._on_device else here
        return self._mixtures[seen, noise]

    def given(
        self, window: Observations, noise: float = 0.0
    ) -> tuple[ConditionalMixture, Float[np.ndarray, "p"]] | None:
        """The mixture for so many positions, and what it is conditioned on; None where there are too few.

        The latter is the newest position [m, world] and behind it the coordinates of the window. ``noise`` is the
        positions' standard deviation [m] beyond what the mixture learned with.
        """
        positions = window.positions
        if len(positions) < LEAST_SEEN:
            return None
        padded = np.repeat(positions[-1:], self._config.observations, axis=0)
        padded[-len(positions) :] = positions
        seen = window_coordinates(padded, self._config.observations, self._anchored)
        return self._mixture(len(positions), noise), np.append(positions[-1], seen)

    def coordinates(self, window: Observations) -> int:
        """How many the mixture is conditioned on: about the squared Mahalanobis distance of a usual window."""
        return 3 * (len(window.times) - 1 + self._anchored)

    def is_unusual(self, window: Observations, distance: float) -> bool:
        """Whether this squared Mahalanobis distance is that of a window unlike all that the mixture knows."""
        return not distance <= UNUSUAL * self.coordinates(window)


def mixture_proposer(config: PredictionConfig, model: TargetModel, world: World | None) -> Proposer:
    """Where the conditional mixture says; constant velocity where too little was seen, or nothing like it in training.

    Raises InputError where the model is for other windows than those of ``config``, or for another room.
    """
    mixture, offsets = WindowMixture(config, model, world), config.offsets

    @in_float64
    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        window = window_of(observations, config)
        given = mixture.given(window)
        if given is None:
            return Proposal(lambda: constant_velocity(observations, offsets), None, Note.PREDICTOR_FALLBACK)
        uniform, normal = draw_randoms(config.steps, config.batch, rng)
        randoms = np.concatenate([uniform[..., None], normal], axis=-1)
        log_weights, means, scored, distance = conditional_draw(*given, randoms)
        if mixture.is_unusual(window, float(distance)):
            return Proposal(lambda: constant_velocity(observations, offsets), None, Note.PREDICTOR_FALLBACK)
        factors = np.asarray(given[0].factors)
        prediction = Prediction(offsets=offsets, log_weights=log_weights, means=means, factors=factors)
        drawn = np.asarray(scored)
        return Proposal(lambda: prediction, Draws(drawn[..., :3], drawn[..., 3]))

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
