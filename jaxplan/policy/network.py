"""The planning policy's network: two GRUs, attention and a variational bottleneck (paper, Sec. II-C and Fig. 2).

The encoder, a bidirectional GRU, reads the segments; the initial state enters only at the decoder, a GRU that gives a
log-duration per segment, and how its end moves where waypoints are placed as well (``placing.py``). All that does not
depend on the initial state is computed by ``encode``, so that the arrival matching repeats little: per segment one
product with the hidden state and one look at the other segments.
"""

import dataclasses
from typing import NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplan.validation import require_within

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
        require_within("network", self, 1, 1024, "hidden", "attention", "latent")


class Memory(NamedTuple):
    """What the decoder needs to know about a sequence; segment first, batch last."""

    real: Bool[Array, "m k"]
    """Which segments are no padding."""
    inputs: Float[Array, "m g k"]
    """Share of the decoder's gates that comes from the segment itself; g is three times the hidden width."""
    keys: Float[Array, "m a k"]
    """What the attention compares,"""
    values: Float[Array, "m a k"]
    """and what it passes on."""
    latent: Float[Array, "l k"]
    """The bottleneck's: all that is known of the sequence as a whole."""


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
        """Apply to each of k columns."""
        initial = nn.initializers.variance_scaling(1.0, "fan_avg", "uniform", in_axis=1, out_axis=0)
        product = self.param("kernel", initial, (self.width, x.shape[-2]), jnp.float32) @ x
        if not self.bias:
            return product
        bias = self.param("bias", nn.initializers.zeros, (self.width, 1), jnp.float32)
        return product + jnp.expand_dims(bias, tuple(range(x.ndim - 2)))


class PolicyNetwork(nn.Module):
    """``outputs`` numbers for each segment; the first is a log-duration in the sequence's own unit."""

    config: NetworkConfig
    outputs: int = 1

    def setup(self) -> None:
        """Name the layers, as the stored weights have them."""
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
        self.head = [Linear(width), Linear(self.outputs)]

    def encode(self, features: Float[Array, "m f k"], real: Bool[Array, "m k"]) -> tuple[Memory, Bottleneck]:
        """Read the features of the segments once; padding, where ``real`` is false, does not matter."""
        embedded = nn.relu(self.embed(features))
        forward, end = self._read(0, embedded, real)
        backward, begin = self._read(1, embedded[::-1], real[::-1])
        read = jnp.concatenate([forward, backward[::-1], embedded], axis=1)
        summary = jnp.concatenate([end, begin])
        bottleneck = Bottleneck(self.mean(summary), self.log_variance(summary))
        return Memory(real, self.gates(read), self.key(read), self.value(read), bottleneck.mean), bottleneck

    def decode(self, memory: Memory, state: Float[Array, "s k"]) -> Float[Array, "m o k"]:
        """The outputs from a sequence's memory and the features of an initial state."""
        seen = nn.relu(self.start[0](jnp.concatenate([memory.latent, state])))
        hidden = softsign(self.start[1](seen))
        constant = self.state_gates(seen)
        keys = memory.keys / np.sqrt(self.config.attention).astype(np.float32)
        blocked = jnp.where(memory.real, np.float32(0.0), BLOCKED)

        def step(carry: _Decoded, segment: _Segment) -> tuple[_Decoded, Float[Array, "o k"]]:
            hidden, last = carry
            inputs, real = segment
            gates, query = jnp.split(self.hidden_gates(hidden), [3 * self.config.hidden])
            weights = jax.nn.softmax(jnp.sum(keys * query[None], axis=1) + blocked, axis=0)
            context = jnp.sum(weights[:, None] * memory.values, axis=0)
            moved = _gru(hidden, inputs + constant + self.context_gates(context) + self.last_gates(last), gates)
            output = self.head[1](nn.relu(self.head[0](moved)))
            return _Decoded(jnp.where(real[None], moved, hidden), jnp.where(real[None], output, last)), output

        carry = _Decoded(hidden, jnp.zeros((self.outputs, hidden.shape[1]), hidden.dtype))
        if self.is_initializing():
            return step(carry, _Segment(memory.inputs[0], memory.real[0]))[1][None]
        return jax.lax.scan(step, carry, _Segment(memory.inputs, memory.real))[1]

    def __call__(
        self, features: Float[Array, "m f k"], real: Bool[Array, "m k"], state: Float[Array, "s k"]
    ) -> Float[Array, "_ o k"]:
        """Encode and decode; for initialisation, when one segment is decoded."""
        return self.decode(self.encode(features, real)[0], state)

    def _read(
        self, direction: int, embedded: Float[Array, "m h k"], real: Bool[Array, "m k"]
    ) -> tuple[Float[Array, "m h k"], Float[Array, "h k"]]:
        """One direction of the encoder; padding leaves the hidden state as it is."""
        inputs = self.read_inputs[direction](embedded)

        def step(hidden: Float[Array, "h k"], segment: _Segment) -> tuple[Float[Array, "h k"], Float[Array, "h k"]]:
            driven, valid = segment
            hidden = jnp.where(valid[None], _gru(hidden, driven, self.read_states[direction](hidden)), hidden)
            return hidden, hidden

        start = jnp.zeros_like(embedded[0])
        if self.is_initializing():
            return embedded, step(start, _Segment(inputs[0], real[0]))[0]
        end, states = jax.lax.scan(step, start, _Segment(inputs, real))
        return states, end


class _Segment(NamedTuple):
    """What a recurrent step reads: one segment, or all of them for a scan."""

    inputs: Float[Array, "*m g k"]
    real: Bool[Array, "*m k"]


class _Decoded(NamedTuple):
    """Carry of the decoder."""

    hidden: Float[Array, "h k"]
    last: Float[Array, "o k"]
    """The outputs of the segment before."""


def _gru(hidden: Float[Array, "h k"], driven: Float[Array, "g k"], own: Float[Array, "g k"]) -> Float[Array, "h k"]:
    """A gated recurrent unit whose products are already taken (Cho et al. 2014, with the reset behind the product).

    ``driven``, by the input, and ``own``, by the hidden state, hold update, reset and candidate: g = 3 h.
    """
    update, reset, candidate = jnp.split(driven, 3)
    own_update, own_reset, own_candidate = jnp.split(own, 3)
    kept = _gate(update + own_update)
    return kept * hidden + (1.0 - kept) * softsign(candidate + _gate(reset + own_reset) * own_candidate)


def softsign(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """x / (1 + |x|): in place of tanh, whose evaluation would cost half of the network's time or more on a CPU."""
    return x / (1.0 + jnp.abs(x))


def _gate(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    return 0.5 + 0.5 * softsign(x)
