"""The learned time allocation as a ``Policy``: the network between world and durations."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplan.policy.features import Frame, segment_features, sequence_frame, state_features
from jaxplan.policy.network import Bottleneck, Memory, NetworkConfig, PolicyNetwork
from jaxplan.policy.protocol import Policy
from jaxplan.spline import FlatStateBatch

LOG_RANGE = 5.0
"""Largest logarithm of a duration in nominal units, so that no input makes a duration infinite."""


def neural_policy(name: str, config: NetworkConfig, parameters: Any) -> Policy:
    """x_i = exp(o_i) * (path length / mean speed) / segments, with o from the network (paper, Sec. II-C).

    Computed in float32 whatever comes in; durations have the precision of the initial state.
    """
    network = PolicyNetwork(config)

    def encode(waypoints: Float[Array, "n 3 k"], count: Int[Array, "k"]) -> tuple[Memory, Frame]:
        frame, memory, _ = read_sequences(network, parameters, waypoints, count)
        return memory, frame

    def decode(context: tuple[Memory, Frame], initial: FlatStateBatch) -> Float[Array, "m k"]:
        memory, frame = context
        precision = jnp.asarray(initial.derivatives).dtype
        return allocate_times(network, parameters, memory, frame, initial).astype(precision)

    return Policy(name, encode, decode)


def read_sequences(
    network: PolicyNetwork, parameters: Any, waypoints: Float[Array, "n 3 k"], count: Int[Array, "k"]
) -> tuple[Frame, Memory, Bottleneck]:
    """What does not depend on the initial state."""
    relative = (waypoints - waypoints[:1]).astype(jnp.float32)
    numbers = jnp.asarray(count).astype(jnp.float32)
    frame = sequence_frame(relative, numbers)
    features, real = segment_features(relative, numbers, frame)
    memory, bottleneck = network.apply(parameters, features, real, method="encode")
    return frame, memory, bottleneck


def allocate_times(
    network: PolicyNetwork, parameters: Any, memory: Memory, frame: Frame, initial: FlatStateBatch
) -> Float[Array, "m k"]:
    """Durations [s], 0 behind the last real segment."""
    state = state_features(jax.tree.map(lambda leaf: leaf.astype(jnp.float32), initial), frame)
    logs = network.apply(parameters, memory, state, method="decode")
    return jnp.where(memory.real, frame.nominal * jnp.exp(jnp.clip(logs, -LOG_RANGE, LOG_RANGE)), 0.0)
