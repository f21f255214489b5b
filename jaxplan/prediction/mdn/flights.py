"""The predictors: whole flights drawn from the network's mixture, of which those that hit something are not believed.

As of ``jaxplan.prediction.particles``: the random numbers are the same in every cycle and spread evenly, and nobody
flies through walls.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxplan.errors import InputError
from jaxplan.prediction.fusion import BLUR, Foretold, Learned, before_the_newest
from jaxplan.prediction.imm_flights import RANDOMS, outside_of_things
from jaxplan.prediction.mdn.checkpoint import TrainedNetwork
from jaxplan.prediction.mdn.curves import COEFFICIENTS, flights_of, places_at
from jaxplan.prediction.mdn.network import FlightMixture, deviations, mixture_of
from jaxplan.prediction.mdn.view import OBSERVATIONS, STEPS, Frame, frame_of, view_of
from jaxplan.prediction.mixture_predictor import LEAST_SEEN
from jaxplan.prediction.observations import Observations
from jaxplan.prediction.particles import even_randoms, fading_flights, fastest_seen, flights_proposal
from jaxplan.prediction.protocol import PredictionConfig, Proposal, Proposer, window_of
from jaxplan.prediction.survival import surroundings_of
from jaxplan.status import Note
from jaxplan.world.obstacles import World

_LOG_TWO_PI = float(np.log(2.0 * np.pi))


def mdn_proposer(config: PredictionConfig, trained: TrainedNetwork, world: World | None) -> Proposer:
    """Flights of the network; with fewer than two positions of an acceleration that fades.

    Raises InputError where ``config`` asks for other windows than the network knows.
    """
    learned, room, offsets = learned_network(config, trained, world), surroundings_of(world), config.offsets
    _, normal = even_randoms(COEFFICIENTS)

    def propose(observations: Observations, rng: np.random.Generator) -> Proposal:
        window, start = window_of(observations, config), outside_of_things(room, observations.positions[-1])
        told = learned(window, 0, 0.0)
        if told is None:
            flights = fading_flights(observations, offsets, normal)
            return flights_proposal(config, room, start, flights, Note.PREDICTOR_FALLBACK)
        return flights_proposal(config, room, start, told.flights, told.note, fastest_seen(window, config))

    return propose


def learned_network(config: PredictionConfig, trained: TrainedNetwork, world: World | None) -> Learned:
    """The network, which finds the noise itself.

    Raises InputError where ``config`` asks for other windows than the network knows.
    """
    _require_known(config, trained)
    room = None if world is None else surroundings_of(world)
    uniform, numbers = even_randoms(RANDOMS)
    normal = np.ascontiguousarray(numbers[:, :COEFFICIENTS]).astype(np.float32)

    def learned(window: Observations, held: int, noise: float) -> Foretold | None:
        if len(window.times) < LEAST_SEEN:
            return None
        shown = [window.positions] + [before_the_newest(window, held).positions] * bool(held)
        count = np.array([len(positions) for positions in shown])
        padded = _padded(shown)
        frame = frame_of(padded, count)
        mixture = mixture_of(trained.parameters, view_of(frame, padded, count, config.dt, room), np)
        factors = deviations(mixture)
        own = flights_of(trained.curves, _drawn(mixture, factors, uniform, normal))
        flights = frame.only(0).to_world(own.reshape(1, -1, 3).astype(np.float64)).reshape(own.shape)
        foreseen = None
        if held:
            ahead = window.positions[-held:]
            foreseen = _log_densities(trained, mixture, factors, frame, ahead, float(np.hypot(BLUR, noise)))
        return Foretold(flights, 0.0, Note(0), foreseen)

    return learned


def _padded(shown: Sequence[Float[np.ndarray, "_ 3"]]) -> Float[np.ndarray, "n w 3"]:
    """Windows of ``OBSERVATIONS`` positions; what was not seen is the oldest that was."""
    return np.stack([np.concatenate([np.repeat(seen[:1], OBSERVATIONS - len(seen), axis=0), seen]) for seen in shown])


def _drawn(
    mixture: FlightMixture,
    factors: Float[np.ndarray, "n k c c"],
    uniform: Float[np.ndarray, "p"],
    normal: Float[np.ndarray, "p c"],
) -> Float[np.ndarray, "p c"]:
    """Coefficients of particles of the first mixture."""
    shares = np.cumsum(np.exp(mixture.log_weights[0]))
    component = (uniform[:, None] * shares[-1] >= shares[None, :-1]).sum(axis=1)
    apart = factors[0, component] @ normal[:, :, None]
    return np.asarray(mixture.means[0, component] + apart[:, :, 0])


def _log_densities(
    trained: TrainedNetwork,
    mixture: FlightMixture,
    factors: Float[np.ndarray, "n k c c"],
    frame: Frame,
    ahead: Float[np.ndarray, "h 3"],
    tolerance: float,
) -> Float[np.ndarray, "h"]:
    """What the last mixture gives to each of the positions [m, world] that come next, to ``tolerance`` [m]."""
    last = frame.only(-1)
    scale = float(last.scale[0])
    places = places_at(trained.curves, len(ahead)).astype(np.float64)
    means = np.einsum("hac,kc->hka", places, mixture.means[-1])
    roots = scale * (places[:, None] @ factors[-1][None])
    spread = roots @ np.swapaxes(roots, -1, -2) + tolerance**2 * np.eye(3)
    off = scale * (last.to_own(ahead[None])[0][:, None] - means)
    white = np.linalg.solve(spread, off[..., None])[..., 0]
    exponents = mixture.log_weights[-1] - 0.5 * ((off * white).sum(axis=-1) + np.linalg.slogdet(spread)[1])
    most = exponents.max(axis=1)
    return np.asarray(most + np.log(np.exp(exponents - most[:, None]).sum(axis=1)) - 1.5 * _LOG_TWO_PI)


def _require_known(config: PredictionConfig, trained: TrainedNetwork) -> None:
    for name, have, want in (
        ("observations", config.observations, (OBSERVATIONS,)),
        ("steps", config.steps, (STEPS,)),
        ("dt", config.dt, trained.intervals),
    ):
        if have not in want:
            known = " or ".join(map(str, want))
            raise InputError(f"predictor: have {name} = {have}, want {known}, which is what the network knows")
