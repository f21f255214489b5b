"""The learned time allocation as a ``Policy``: the network between world and durations."""

from typing import Any, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplan.arrays import AnyArray
from jaxplan.policy.features import Frame, segment_features, sequence_frame, state_features
from jaxplan.policy.network import Bottleneck, Memory, NetworkConfig, PolicyNetwork
from jaxplan.policy.protocol import Policy
from jaxplan.spline import FlatStateBatch
from jaxplan.vehicle.identity import VehicleId

LOG_RANGE = 5.0
"""Largest logarithm of a duration in nominal units, so that no input makes a duration infinite."""


def neural_policy(name: str, config: NetworkConfig, parameters: Any, vehicle: VehicleId | None = None) -> Policy:
    """x_i = exp(o_i) * (path length / mean speed) / segments, with o from the network (paper, Sec. II-C).

    Computed in float32 whatever comes in; durations have the precision of the initial state.

    Args:
        name: for messages.
        config: sizes of the network.
        parameters: its weights, a tree as Flax has it.
        vehicle: for which it was trained; None where that does not matter, as in measurements.
    """
    network = PolicyNetwork(config)

    def encode(waypoints: Float[AnyArray, "n 3 k"], count: Int[AnyArray, "k"]) -> tuple[Memory, Frame]:
        frame, memory, _ = read_sequences(network, parameters, waypoints, count)
        return memory, frame

    def decode(context: tuple[Memory, Frame], initial: FlatStateBatch) -> Float[Array, "m k"]:
        memory, frame = context
        precision = jnp.asarray(initial.derivatives).dtype
        return allocate_times(network, parameters, memory, frame, initial).astype(precision)

    return Policy(name, encode, decode, vehicle)


def read_sequences(
    network: PolicyNetwork, parameters: Any, waypoints: Float[AnyArray, "n 3 k"], count: Int[AnyArray, "k"]
) -> tuple[Frame, Memory, Bottleneck]:
    """Frame, memory and bottleneck of k sequences [m, world]: what does not depend on the initial state (float32)."""
    relative = (waypoints - waypoints[:1]).astype(jnp.float32)
    numbers = jnp.asarray(count).astype(jnp.float32)
    frame = sequence_frame(relative, numbers)
    features, real = segment_features(relative, numbers, frame)
    read = network.apply(parameters, features, real, method="encode")
    memory, bottleneck = cast(tuple[Memory, Bottleneck], read)
    return frame, memory, bottleneck


def allocate_times(
    network: PolicyNetwork, parameters: Any, memory: Memory, frame: Frame, initial: FlatStateBatch
) -> Float[Array, "m k"]:
    """Durations [s], 0 behind the last real segment."""
    state = state_features(jax.tree.map(lambda leaf: leaf.astype(jnp.float32), initial), frame)
    logs = cast(Array, network.apply(parameters, memory, state, method="decode"))[:, 0]
    return jnp.where(memory.real, frame.nominal[None] * jnp.exp(jnp.clip(logs, -LOG_RANGE, LOG_RANGE)), 0.0)
