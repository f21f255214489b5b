"""The planning policy's network: two GRUs, attention and a variational bottleneck (paper, Sec. II-C and Fig. 2).

The encoder, a bidirectional GRU, reads the segments; the initial state enters only at the decoder, a GRU that gives one
log-duration per segment. All that does not depend on the initial state is computed by ``encode``, so that the arrival
matching repeats little: per segment one product with the hidden state and one look at the other segments.
"""

import dataclasses
from typing import NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplan.errors import InputError

BLOCKED = np.float32(-1e9)
"""Attention score of padding."""


@dataclasses.dataclass(frozen=True)
class NetworkConfig:
    """Sizes of the network."""

    hidden: int = 64
    """Width of the decoder's GRU, and of both directions of the encoder's together."""
    attention: int = 32
    """Width of keys, queries and values."""
    latent: int = 32
    """Width of the bottleneck."""

    def __post_init__(self) -> None:
        for name in ("hidden", "attention", "latent"):
            if not 1 <= getattr(self, name) <= 1024:
                raise InputError(f"network: {name} is {getattr(self, name)}, want 1 to 1024")


class Memory(NamedTuple):
    """What the decoder needs to know about a sequence; segment first, batch last."""

    real: Bool[Array, "m k"]
    inputs: Float[Array, "m 3h k"]
    """Share of the decoder's gates that comes from the segment itself."""
    keys: Float[Array, "m a k"]
    values: Float[Array, "m a k"]
    latent: Float[Array, "l k"]


class Bottleneck(NamedTuple):
    """Mean and log-variance of the latent distribution."""

    mean: Float[Array, "l k"]
    log_variance: Float[Array, "l k"]


class Linear(nn.Module):
    """W x + b over the last axis but one, so that the batch stays last and contiguous."""

    width: int
    bias: bool = True

    @nn.compact
    def __call__(self, x: Float[Array, "*m i k"]) -> Float[Array, "*m o k"]:
        initial = nn.initializers.variance_scaling(1.0, "fan_avg", "uniform", in_axis=1, out_axis=0)
        product = self.param("kernel", initial, (self.width, x.shape[-2]), jnp.float32) @ x
        return (
            product + self.param("bias", nn.initializers.zeros, (self.width, 1), jnp.float32) if self.bias else product
        )


class PolicyNetwork(nn.Module):
    """Log-durations in units of each sequence's nominal segment time."""

    config: NetworkConfig

    def setup(self) -> None:
        width, attention = self.config.hidden, self.config.attention
        reader = width // 2
        self.embed = Linear(reader)
        self.read_inputs = [Linear(3 * reader) for _ in range(2)]
        self.read_states = [Linear(3 * reader, bias=False) for _ in range(2)]
        self.mean, self.log_variance = Linear(self.config.latent), Linear(self.config.latent)
        self.key, self.value = Linear(attention), Linear(attention)
        self.gates = Linear(3 * width)
        self.start = [Linear(width), Linear(width)]
        self.state_gates = Linear(3 * width, bias=False)
        self.hidden_gates = Linear(3 * width + attention, bias=False)
        self.context_gates, self.last_gates = Linear(3 * width, bias=False), Linear(3 * width, bias=False)
        self.head = [Linear(width), Linear(1)]

    def encode(self, features: Float[Array, "m f k"], real: Bool[Array, "m k"]) -> tuple[Memory, Bottleneck]:
        """Read the segments once."""
        embedded = nn.relu(self.embed(features))
        forward, end = self._read(0, embedded, real)
        backward, begin = self._read(1, embedded[::-1], real[::-1])
        read = jnp.concatenate([forward, backward[::-1], embedded], axis=1)
        summary = jnp.concatenate([end, begin])
        bottleneck = Bottleneck(self.mean(summary), self.log_variance(summary))
        return Memory(real, self.gates(read), self.key(read), self.value(read), bottleneck.mean), bottleneck

    def decode(self, memory: Memory, state: Float[Array, "s k"]) -> Float[Array, "m k"]:
        """Log-durations from a sequence's memory and the features of an initial state."""
        seen = nn.relu(self.start[0](jnp.concatenate([memory.latent, state])))
        hidden = softsign(self.start[1](seen))
        constant = self.state_gates(seen)
        keys = memory.keys / np.sqrt(self.config.attention).astype(np.float32)
        blocked = jnp.where(memory.real, 0.0, BLOCKED)

        def step(carry: tuple, segment: tuple) -> tuple:
            hidden, last = carry
            inputs, real = segment
            gates, query = jnp.split(self.hidden_gates(hidden), [3 * self.config.hidden])
            weights = jax.nn.softmax(jnp.sum(keys * query, axis=1) + blocked, axis=0)
            context = jnp.sum(weights[:, None] * memory.values, axis=0)
            moved = _gru(hidden, inputs + constant + self.context_gates(context) + self.last_gates(last), gates)
            output = self.head[1](nn.relu(self.head[0](moved)))
            return (jnp.where(real, moved, hidden), jnp.where(real, output, last)), output[0]

        carry = (hidden, jnp.zeros_like(hidden[:1]))
        if self.is_initializing():
            return step(carry, (memory.inputs[0], memory.real[0]))[1]
        return jax.lax.scan(step, carry, (memory.inputs, memory.real))[1]

    def __call__(self, features: Float[Array, "m f k"], real: Bool[Array, "m k"], state: Float[Array, "s k"]) -> Array:
        """Encode and decode; for initialisation."""
        return self.decode(self.encode(features, real)[0], state)

    def _read(
        self, direction: int, embedded: Float[Array, "m h k"], real: Bool[Array, "m k"]
    ) -> tuple[Float[Array, "m h k"], Float[Array, "h k"]]:
        """One direction of the encoder; padding leaves the hidden state as it is."""
        inputs = self.read_inputs[direction](embedded)

        def step(hidden: Array, segment: tuple) -> tuple:
            driven, valid = segment
            hidden = jnp.where(valid, _gru(hidden, driven, self.read_states[direction](hidden)), hidden)
            return hidden, hidden

        start = jnp.zeros_like(embedded[0])
        if self.is_initializing():
            return embedded, step(start, (inputs[0], real[0]))[0]
        end, states = jax.lax.scan(step, start, (inputs, real))
        return states, end


def _gru(hidden: Float[Array, "h k"], driven: Float[Array, "3h k"], own: Float[Array, "3h k"]) -> Float[Array, "h k"]:
    """A gated recurrent unit whose products are already taken (Cho et al. 2014, with the reset behind the product)."""
    update, reset, candidate = jnp.split(driven, 3)
    own_update, own_reset, own_candidate = jnp.split(own, 3)
    kept = _gate(update + own_update)
    return kept * hidden + (1.0 - kept) * softsign(candidate + _gate(reset + own_reset) * own_candidate)


def softsign(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """x / (1 + |x|): in place of tanh, whose evaluation would cost half of the network's time or more on a CPU."""
    return x / (1.0 + jnp.abs(x))


def _gate(x: Float[Array, "..."]) -> Float[Array, "..."]:
    return 0.5 + 0.5 * softsign(x)
