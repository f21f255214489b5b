"""Prediction by particles: whole futures of the target, of which those that hit something are not believed.

A particle is a draw from the joint distribution of all future positions, by a mixture, or where it does not know such
a flight by a velocity that is kept but for an acceleration that fades (Singer, IEEE Transactions on Aerospace and
Electronic Systems 6(4), 1970). Nobody flies through walls: a particle counts until it would hit the room or an
obstacle, and where none is left those that lasted longest wait in front of what they would hit. Goals are particles'
positions, and their mean; a goal is worth the share of particles within the capture radius, which is the
probability that who is there then meets the target. The random numbers are the same in every cycle, and spread more
evenly than random ones (Sobol's), so that goals move as the target does and not as the dice fall.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.special import ndtri

from jaxplan.arrays import AnyArray
from jaxplan.precision import in_float64
from jaxplan.prediction.kinematic import expected_acceleration, newest_velocity
from jaxplan.prediction.mixture import MODES, ConditionalMixture, Prediction, condition
from jaxplan.prediction.mixture_predictor import WindowMixture
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.protocol import Draws, Flights, PredictionConfig, Proposal, Proposer
from jaxplan.prediction.target_model import TargetModel
from jaxplan.status import Note
from jaxplan.world.clearance import free_distance
from jaxplan.world.obstacles import World

PARTICLES = 128
CAPTURE_RADIUS = 0.36
"""m; as the replanner's ``reach``: who passes within that of the expected target meets it."""
LEAST_CLEARANCE = 0.1
"""m between a particle and what it hits: a small drone's radius; less where the target is seen nearer."""
STOPPED_WEIGHT = 0.25
"""Of a whole flight that hits something at once, where one that never does has 1 more: where it stops is a guess at
where the target turns (arbitrary)."""
ROUNDING = 1e-6
"""m; by which goals are farther from the room's faces than they must be."""
FASTER, LEAST_FASTEST = 1.25, 2.0
"""Times as fast as it was seen to fly, and m/s, that a target is taken to fly at most, once enough was seen of it."""
DOUBTED = 512
"""Ways between two steps of which the middle is looked at."""
FADING = 1.0
"""Time constant [s] of an unknown acceleration (arbitrary: quadrotors among obstacles turn every second or so)."""


def particle_proposer(config: PredictionConfig, model: TargetModel, world: World | None) -> Proposer:
    """Particles of the conditional mixture, or of a fading acceleration where it does not know such a flight.

    Raises InputError where the model is for other windows than those of ``config``, or for another room.
    """
    mixture, offsets = WindowMixture(config, model, world), config.offsets
    uniform, normal = even_randoms()
    room = None if world is None else in_float64(jax.device_put)(world)

    @in_float64
    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        newest, note, flights = observations.positions[-1], Note(0), None
        given = mixture.given(observations)
        if given is not None:
            flights, distance = mixture_flights(*given, uniform, normal)
            flights = None if mixture.is_unusual(observations, float(distance)) else flights
        if flights is None:
            flights, note = fading_flights(observations, offsets, normal), Note.PREDICTOR_FALLBACK
        return flights_proposal(config, room, newest, flights, note, fastest_seen(observations, config))

    return propose


def flights_proposal(
    config: PredictionConfig,
    room: World | None,
    newest: Float[AnyArray, "3"],
    flights: Float[AnyArray, "n s 3"],
    note: Note,
    fastest: float = np.inf,
) -> Proposal:
    """What particles from ``newest`` [m, world] propose in a room, no faster than ``fastest`` [m/s] (host)."""
    flights = np.asarray(flights)
    if np.isfinite(fastest):
        flights = slowed(np.asarray(newest), flights, fastest * config.dt)
    stopped, counts = believable(room, jnp.asarray(newest), jnp.asarray(flights))
    goals, likelihood = goals_among(room, stopped, counts, config.batch)
    prediction, draws = _prediction(stopped, counts, config.offsets), Draws(np.asarray(goals), np.log(likelihood))
    whole = Flights(np.asarray(newest), np.asarray(stopped), STOPPED_WEIGHT + np.asarray(counts).mean(axis=1))
    return Proposal(prediction, draws, note, whole)


def fastest_seen(observations: Observations, config: PredictionConfig) -> float:
    """How fast [m/s] the target is taken to fly at most; infinite where too little was seen to say."""
    times, positions = (array[-config.observations :] for array in (observations.times, observations.positions))
    if len(times) < config.observations:
        return np.inf
    speeds = np.linalg.norm(np.diff(positions, axis=0), axis=1) / np.diff(times)
    return max(FASTER * float(speeds.max()), LEAST_FASTEST)


def slowed(
    newest: Float[np.ndarray, "3"], flights: Float[np.ndarray, "n s 3"], longest: float
) -> Float[np.ndarray, "n s 3"]:
    """Flights from ``newest`` [m, world] whose steps are no longer than ``longest`` [m], in their own directions."""
    steps = np.diff(np.concatenate([np.broadcast_to(newest, (len(flights), 1, 3)), flights], axis=1), axis=1)
    lengths = np.linalg.norm(steps, axis=2, keepdims=True)
    return np.asarray(newest + np.cumsum(steps * np.minimum(1.0, longest / np.maximum(lengths, 1e-12)), axis=1))


def even_randoms(normals: int = MODES) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p r"]]:
    """Uniform and standard normal numbers for ``PARTICLES``, any first ones of which are spread evenly."""
    from scipy.stats import qmc  # half a second, for those who draw only

    points = qmc.Sobol(1 + normals, rng=0).random(PARTICLES)
    return points[:, 0], ndtri(points[:, 1:])


@jax.jit
def mixture_flights(
    model: ConditionalMixture, seen: Float[Array, "p"], uniform: Float[Array, "n"], normal: Float[Array, "n r"]
) -> tuple[Float[Array, "n s 3"], Float[Array, ""]]:
    """Particles [m, world] from a mixture given what was seen, and how unusual that is (as ``condition``).

    Args:
        seen: the newest position [m, world], and behind it what is observed.
        uniform, normal: numbers in [0, 1) that choose the components, and standard normal ones.
    """
    log_weights, means, distance = condition(model, seen[3:])
    shares = jnp.tril(jnp.ones((len(log_weights), len(log_weights)))) @ jnp.exp(log_weights)
    component = (uniform[:, None] * shares[-1] >= shares[None, :-1]).sum(axis=-1)
    apart = (normal[:, :, None] * jnp.asarray(model.modes)[component]).sum(axis=1)
    return seen[None, None, :3] + jnp.moveaxis(means, 2, 0)[component] + apart.reshape(len(normal), -1, 3), distance


def fading_flights(
    observations: Observations, offsets: Float[np.ndarray, "s"], normal: Float[np.ndarray, "n r"]
) -> Float[np.ndarray, "n s 3"]:
    """Particles [m, world] that keep the newest velocity but for an acceleration that fades (host)."""
    velocity = newest_velocity(observations)
    gain = FADING * (offsets - FADING * (1.0 - np.exp(-offsets / FADING)))
    straight = observations.positions[-1] + offsets[:, None] * velocity
    acceleration = expected_acceleration(float(np.linalg.norm(velocity))) * normal[:, None, :3]
    return np.asarray(straight[None] + gain[None, :, None] * acceleration)


@jax.jit
def believable(
    world: World | None, newest: Float[Array, "3"], flights: Float[Array, "n s 3"]
) -> tuple[Float[Array, "n s 3"], Float[Array, "n s"]]:
    """Particles that stop before what they would hit, and 1 where one counts: it has hit nothing, or the last of all.

    Looked at are the steps, and of the ways between them the middles of those that are not clear for sure, because
    both ends are farther from anything than the way is long; of many the ``DOUBTED`` most doubtful.

    Args:
        world: None where nothing is known of it.
        newest: where the target was seen last [m, world].
    """
    steps = flights.shape[1]
    if world is None:
        return flights, jnp.ones(flights.shape[:2])
    before = jnp.concatenate([jnp.broadcast_to(newest, flights[:, :1].shape), flights[:, :-1]], axis=1)
    free, here = free_distance(world, flights), free_distance(world, newest)
    least = jnp.minimum(LEAST_CLEARANCE, here)
    slack = free + jnp.concatenate([jnp.broadcast_to(here, free[:, :1].shape), free[:, :-1]], axis=1)
    doubt = -(slack - jnp.sqrt(((flights - before) ** 2).sum(axis=-1))).reshape(-1)
    doubted = jax.lax.top_k(doubt, min(DOUBTED, doubt.size))[1]
    middles = (0.5 * (before + flights)).reshape(-1, 3)[doubted]
    clear = (free >= least).reshape(-1).at[doubted].min(free_distance(world, middles) >= least)
    lasted = jnp.cumprod(clear.reshape(free.shape).astype(flights.dtype), axis=1).sum(axis=1)
    step = jnp.arange(1, steps + 1, dtype=flights.dtype)
    counts = (lasted[:, None] >= jnp.minimum(step, lasted.max())[None]).astype(flights.dtype)
    at: Int[Array, "n s"] = jnp.minimum(step[None], lasted[:, None]).astype(jnp.int32)
    whole = jnp.concatenate([jnp.broadcast_to(newest, flights[:, :1].shape), flights], axis=1)
    return jnp.take_along_axis(whole, at[..., None], axis=1), counts


@jax.jit(static_argnames="batch")
def goals_among(
    world: World | None, flights: Float[Array, "n s 3"], counts: Float[Array, "n s"], batch: int
) -> tuple[Float[Array, "s b 3"], Float[Array, "s b"]]:
    """The first particles that count, after their mean, as goals [m, world]; the probability that each captures."""
    order = jnp.argsort(1.0 - counts, axis=0, stable=True)
    number = counts.sum(axis=0)
    place = jnp.arange(batch, dtype=jnp.int32)[:, None] % number.astype(jnp.int32)[None]
    taken = jnp.take_along_axis(order, place, axis=0)
    goals = jnp.take_along_axis(flights, taken[..., None], axis=0)
    mean = (counts[..., None] * flights).sum(axis=0) / number[:, None]
    possible = True if world is None else free_distance(world, mean) >= LEAST_CLEARANCE
    goals = goals.at[0].set(jnp.where(jnp.asarray(possible)[..., None], mean, goals[0]))
    goals = goals if world is None else _inside(world, goals)
    apart = flights[None] - goals[:, None]
    near = (apart * apart).sum(axis=-1) <= CAPTURE_RADIUS**2
    caught = jnp.maximum(jnp.where(near, counts[None], 0.0).sum(axis=1), 1.0) / number[None]
    return jnp.moveaxis(goals, 0, 1), caught.T


def _inside(world: World, goals: Float[Array, "b s 3"]) -> Float[Array, "b s 3"]:
    """Goals as far from the room's faces as goals must be: who passes there still meets a target that is nearer."""
    lower, upper = jnp.asarray(world.bounds, goals.dtype)
    middle, least = 0.5 * (lower + upper), jnp.asarray(world.keep_in, goals.dtype) + ROUNDING
    return jnp.clip(
        goals, jnp.minimum(lower + least, middle)[None, None], jnp.maximum(upper - least, middle)[None, None]
    )


def _prediction(
    flights: Float[Array, "n s 3"], counts: Float[Array, "n s"], offsets: Float[np.ndarray, "s"]
) -> Prediction:
    """A kernel at each particle that counts, as wide as Silverman's rule has it (1986), and at least 2 cm (host)."""
    positions, weights = np.asarray(flights), np.asarray(counts)
    order = np.argsort(1.0 - weights, axis=0, kind="stable")
    number = weights.sum(axis=0).astype(int)
    place = np.arange(len(positions))[:, None] % number[None]
    means = np.take_along_axis(positions, np.take_along_axis(order, place, axis=0)[..., None], axis=0)
    spread = np.sqrt(means.var(axis=0).mean(axis=-1))
    width = np.maximum(0.02, 0.97 * number ** (-1.0 / 7.0) * spread)
    factors = np.broadcast_to(
        width[:, None, None, None] * np.eye(3)[None, :, :, None], (len(offsets), 3, 3, len(means))
    )
    log_weights = np.full(len(means), -np.log(len(means)))
    return Prediction(offsets=offsets, log_weights=log_weights, means=np.moveaxis(means, 0, -1), factors=factors)
