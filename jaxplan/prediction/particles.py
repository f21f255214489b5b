"""Prediction by particles: whole futures of the target, of which those that hit something are not believed.

A particle is a draw from the joint distribution of all future positions, by a mixture, or where it does not know such
a flight by a velocity that is kept but for an acceleration that fades (Singer, IEEE Transactions on Aerospace and
Electronic Systems 6(4), 1970). Nobody flies through walls: a particle counts until it would hit the room or an
obstacle, and where none is left those that lasted longest wait in front of what they would hit. Goals are particles'
positions, and their mean; a goal is worth the share of particles within the capture radius, which is the
probability that who is there then meets the target. The random numbers are the same in every cycle, and spread more
evenly than random ones (Sobol's), so that goals move as the target does and not as the dice fall.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtri

from jaxplan.arrays import AnyArray
from jaxplan.prediction.kernels.mixture import conditioned, flights_of
from jaxplan.prediction.kinematic import expected_acceleration, newest_velocity
from jaxplan.prediction.mixture import MODES, ConditionalMixture, Prediction
from jaxplan.prediction.mixture_predictor import WindowMixture
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.protocol import Draws, Flights, PredictionConfig, Proposal, Proposer, window_of
from jaxplan.prediction.survival import Surroundings, believable, goals_among, surroundings_of
from jaxplan.prediction.target_model import TargetModel
from jaxplan.status import Note
from jaxplan.world.obstacles import World

_EVEN, _EVEN_BITS = Path(__file__).parent / "even", 30
"""Where tables of Sobol points lie, in integers of so many bits, by their dimension."""
PARTICLES = 128
STOPPED_WEIGHT = 0.25
"""Of a whole flight that hits something at once, where one that never does has 1 more: where it stops is a guess at
where the target turns (arbitrary)."""
FASTER, LEAST_FASTEST = 1.25, 2.0
"""Times as fast as it was seen to fly, and m/s, that a target is taken to fly at most, once enough was seen of it."""
FADING = 1.0
"""Time constant [s] of an unknown acceleration (arbitrary: quadrotors among obstacles turn every second or so)."""


def particle_proposer(config: PredictionConfig, model: TargetModel, world: World | None) -> Proposer:
    """Particles of the conditional mixture, or of a fading acceleration where it does not know such a flight.

    Raises InputError where the model is for other windows than those of ``config``, or for another room.
    """
    mixture, offsets = WindowMixture(config, model, world, on_device=False), config.offsets
    uniform, normal = even_randoms()
    room = surroundings_of(world)

    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        newest, note, flights = observations.positions[-1], Note(0), None
        window = window_of(observations, config)
        given = mixture.given(window)
        if given is not None:
            flights, distance = mixture_flights(*given, uniform, normal)
            flights = None if mixture.is_unusual(window, distance) else flights
        if flights is None:
            flights, note = fading_flights(observations, offsets, normal), Note.PREDICTOR_FALLBACK
        return flights_proposal(config, room, newest, flights, note, fastest_seen(window, config))

    return propose


def flights_proposal(
    config: PredictionConfig,
    room: Surroundings,
    newest: Float[AnyArray, "3"],
    flights: Float[AnyArray, "n s 3"],
    note: Note,
    fastest: float = np.inf,
) -> Proposal:
    """What particles from ``newest`` [m, world] propose in a room, no faster than ``fastest`` [m/s] (host)."""
    newest = np.asarray(newest)
    stopped, counts = believable(room, newest, np.asarray(flights), fastest * config.dt)
    goals, likelihood = goals_among(room, stopped, counts, config.batch)
    whole = Flights(newest, stopped, STOPPED_WEIGHT + counts.mean(axis=1))
    return Proposal(lambda: _prediction(stopped, counts, config.offsets), Draws(goals, np.log(likelihood)), note, whole)


def fastest_seen(window: Observations, config: PredictionConfig) -> float:
    """How fast [m/s] the target is taken to fly at most; infinite where too little was seen to say."""
    if len(window.times) < config.observations:
        return np.inf
    speeds = np.linalg.norm(np.diff(window.positions, axis=0), axis=1) / np.diff(window.times)
    return max(FASTER * float(speeds.max()), LEAST_FASTEST)


def even_randoms(normals: int = MODES) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p r"]]:
    """Uniform and standard normal numbers for ``PARTICLES``, any first ones of which are spread evenly.

    They are scrambled Sobol points, ``scipy.stats.qmc.Sobol(1 + normals, rng=0)``, which come from a file: importing
    that module takes half a second of every start. ``normals`` is 18 or 19.
    """
    points = np.load(_EVEN / f"{1 + normals}.npy") * 2.0**-_EVEN_BITS
    return points[:, 0], ndtri(points[:, 1:])


def mixture_flights(
    model: ConditionalMixture,
    seen: Float[np.ndarray, "p"],
    uniform: Float[np.ndarray, "n"],
    normal: Float[np.ndarray, "n r"],
) -> tuple[Float[np.ndarray, "n s 3"], float]:
    """Particles [m, world] from a mixture given what was seen, and how unusual that is (as ``condition``; host).

    Args:
        model: in NumPy.
        seen: the newest position [m, world], and behind it what is observed.
        uniform, normal: numbers in [0, 1) that choose the components, and standard normal ones.
    """
    given = conditioned(model, seen[3:])
    return flights_of(model, given, seen[:3], uniform, normal), given.distance


def fading_flights(
    observations: Observations, offsets: Float[np.ndarray, "s"], normal: Float[np.ndarray, "n r"]
) -> Float[np.ndarray, "n s 3"]:
    """Particles [m, world] that keep the newest velocity but for an acceleration that fades (host)."""
    velocity = newest_velocity(observations)
    gain = FADING * (offsets - FADING * (1.0 - np.exp(-offsets / FADING)))
    straight = observations.positions[-1] + offsets[:, None] * velocity
    acceleration = expected_acceleration(float(np.linalg.norm(velocity))) * normal[:, None, :3]
    return np.asarray(straight[None] + gain[None, :, None] * acceleration)


def _prediction(
    flights: Float[np.ndarray, "n s 3"], counts: Bool[np.ndarray, "n s"], offsets: Float[np.ndarray, "s"]
) -> Prediction:
    """A kernel at each particle that counts, as wide as Silverman's rule has it (1986), and at least 2 cm (host)."""
    order, number = np.argsort(~counts, axis=0, kind="stable"), counts.sum(axis=0)
    place = np.arange(len(flights))[:, None] % number
    means = np.take_along_axis(flights, np.take_along_axis(order, place, axis=0)[..., None], axis=0)
    spread = np.sqrt(means.var(axis=0).mean(axis=-1))
    width = np.maximum(0.02, 0.97 * number ** (-1.0 / 7.0) * spread)
    factors = np.broadcast_to(
        width[:, None, None, None] * np.eye(3)[None, :, :, None], (len(offsets), 3, 3, len(means))
    )
    log_weights = np.full(len(means), -np.log(len(means)))
    return Prediction(offsets=offsets, log_weights=log_weights, means=np.moveaxis(means, 0, -1), factors=factors)
