"""Wind, gusts and thrust losses: closed forms on a falling vehicle, and what the controller makes of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.errors import InputError
from jaxplan.minsnap.single import minimum_snap
from jaxplan.precision import float32_island
from jaxplan.tracking.disturbance import Disturbance, air_velocity
from jaxplan.tracking.filters import FilterState
from jaxplan.tracking.model import vehicle_body
from jaxplan.tracking.plant import DT, Noise, PlantState, physics_step
from jaxplan.tracking.track import TrackConfig, track
from jaxplan.vehicle.load import load_vehicle
from tolerances import tolerance


def test_wind_and_thrust_loss_follow_their_closed_forms() -> None:
    vehicle = load_vehicle()
    hover = np.sqrt(vehicle.mass * vehicle.gravity / (4 * vehicle.thrust_coefficient))
    body, steps = vehicle_body(vehicle), 80
    silence = Noise(*(np.zeros(3, np.float32) for _ in range(4)))

    def fly(disturbance: Disturbance) -> jax.Array:
        blank = jnp.zeros(3)
        signals = FilterState(value=jnp.zeros((4, 3)), rate=jnp.zeros((4, 3)))
        state = PlantState(
            pos=blank,
            vel=blank,
            quat_wxyz=jnp.array([1.0, 0.0, 0.0, 0.0]),
            body_rates=blank,
            rotor_speeds=jnp.full(4, hover),
            signals=signals,
            key=jax.random.key(0),
            step=jnp.int32(0),
        )
        cast, commands = vehicle.astype(jnp.float32), jnp.full(4, hover)

        def step(state: PlantState, index: jax.Array) -> tuple[PlantState, None]:
            return physics_step(cast, body, state, commands, silence, disturbance, index * DT), None

        return jax.lax.scan(step, state, jnp.arange(steps))[0].vel

    lanes = Disturbance(
        wind=np.array([[8.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
        gust=np.array([[0.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 0.0, 0.0]]),
        gust_start=np.array([0.0, 0.05, 0.0]),
        gust_duration=np.array([0.0, 0.1, 0.0]),
        thrust_loss=np.array([[0.0] * 4, [0.0] * 4, [0.2] * 4]),
    )
    velocity = np.asarray(float32_island(jax.vmap(fly))(lanes))
    duration, rate = steps * DT, vehicle.drag_coefficient / vehicle.mass
    # a still vehicle is taken along: the airspeed r = u - v obeys r' = -c r^2 / m; first order in DT
    assert velocity[0, 0] == pytest.approx(8.0 - 8.0 / (1.0 + rate * 8.0 * duration), rel=0.01)
    # the mean of ((1 - cos) / 2)^2 is 3/8; the vehicle's own speed, 0.12 m/s in the end, takes off about 3 %
    assert velocity[1, 1] == pytest.approx(rate * 25.0 * 0.375 * 0.1, rel=0.05)
    assert velocity[2, 2] == pytest.approx(-0.2 * vehicle.gravity * duration, rel=0.01)
    np.testing.assert_allclose(velocity[2, :2], 0.0, **tolerance("solve"))


def test_the_gust_rises_and_falls() -> None:
    disturbance = Disturbance(wind=(1.0, 0.0, 0.0), gust=(0.0, 4.0, 0.0), gust_start=1.0, gust_duration=2.0)
    air = [np.asarray(air_velocity(disturbance, jnp.float32(t))) for t in (0.5, 1.0, 1.5, 2.0, 3.0, 9.0)]
    np.testing.assert_allclose(np.array(air)[:, 1], [0.0, 0.0, 2.0, 4.0, 0.0, 0.0], **tolerance("exact", np.float32))
    np.testing.assert_allclose(np.array(air)[:, 0], 1.0)
    np.testing.assert_array_equal(air_velocity(Disturbance(gust=(1.0, 1.0, 1.0)), jnp.float32(0.0)), 0.0)


@pytest.mark.slow
def test_indi_holds_in_wind_and_with_a_weak_rotor_and_calm_changes_nothing() -> None:
    spline = minimum_snap(np.array([[0.0, 0.0, 1.0], [3.0, 1.0, 1.5]]), np.array([3.0]))
    flights, quiet = [spline] * 5, TrackConfig(noise=False)
    loss = np.zeros((5, 4))
    loss[2, 0] = 0.1
    wind = np.zeros((5, 3))
    wind[1] = [6.0, 0.0, 0.0]
    gust = np.zeros((5, 3))
    gust[3] = [0.0, 8.0, 0.0]
    gust[4] = [0.0, 0.0, np.sqrt(1e9)]
    disturbance = Disturbance(
        wind=wind, gust=gust, gust_start=np.full(5, 0.5), gust_duration=np.full(5, 1.0), thrust_loss=loss
    )
    result = track(flights, config=quiet, disturbance=disturbance)
    calm = track([spline], config=quiet)
    np.testing.assert_allclose(
        result.max_position_error[0], calm.max_position_error[0], **tolerance("exact", np.float32)
    )
    assert np.all(result.max_position_error[[1, 3]] > 0.05)
    assert np.all(result.max_position_error[1:4] < 0.20)
    assert abs(result.max_position_error[2] - result.max_position_error[0]) > 1e-4  # a tenth of a rotor: felt, held
    assert not result.feasible[4]


def test_bad_disturbances_are_named() -> None:
    spline = minimum_snap(np.array([[0.0, 0.0, 1.0], [3.0, 1.0, 1.5]]), np.array([3.0]))
    for fields, said in (
        ({"wind": (1.0, 2.0)}, "wind"),
        ({"gust": (np.nan, 0.0, 0.0)}, "gust"),
        ({"gust_duration": -1.0}, "gust_duration"),
        ({"thrust_loss": (0.0, 0.0, 0.0, 1.5)}, "thrust_loss"),
    ):
        with pytest.raises(InputError, match=said):
            Disturbance(**fields)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="disturbance: have shape"):
        track([spline] * 2, disturbance=Disturbance(wind=np.zeros((3, 3))))
