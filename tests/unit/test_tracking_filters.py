"""The low-pass filter against SciPy's discretisation and against its own frequency response."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy import signal

from jaxplan.tracking.filters import CUTOFF_HZ, FilterState, filter_step
from tolerances import tolerance


def run(inputs: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    with jax.enable_x64(True):
        zero = FilterState(value=jnp.zeros(()), rate=jnp.zeros(()))

        def step(state: FilterState, u: jax.Array) -> tuple[FilterState, tuple[jax.Array, jax.Array]]:
            state = filter_step(state, u, dt)
            return state, (state.value, state.rate)

        _, (value, rate) = jax.jit(lambda u: jax.lax.scan(step, zero, u))(jnp.asarray(inputs))
    return np.asarray(value), np.asarray(rate)


def test_equals_the_implicit_euler_butterworth_of_scipy() -> None:
    dt = 1.0 / 400.0
    omega = 2 * np.pi * CUTOFF_HZ
    numerator, denominator = signal.butter(2, omega, analog=True)
    system = signal.cont2discrete((numerator, denominator), dt, method="backward_diff")
    inputs = np.random.default_rng(0).normal(size=300)
    # cont2discrete works with states of another scale: rounding grows to 1e-9.
    expected = signal.lfilter(np.squeeze(system[0]), system[1], inputs)
    value, rate = run(inputs, dt)
    np.testing.assert_allclose(value, expected, **tolerance("formula"))
    np.testing.assert_allclose(rate[1:], np.diff(value) / dt, **tolerance("formula"))


def test_passes_constants_and_halves_the_power_at_the_cutoff() -> None:
    dt = 1e-5
    t = np.arange(40000) * dt
    assert abs(run(np.ones(40000), dt)[0][-1] - 1.0) < 1e-6
    value, _ = run(np.sin(2 * np.pi * CUTOFF_HZ * t), dt)
    # 30 Hz over 0.4 s; the step of 1e-5 s leaves an error of omega dt = 0.2 %
    assert abs(np.max(value[20000:]) - np.sqrt(0.5)) < 5e-3
