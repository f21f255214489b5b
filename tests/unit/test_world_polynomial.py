"""The clearance bound of whole curves: never above a dense sampling, needles included, and tight when cut fine."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplan.world.clearance import clearance, wall_clearance
from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.obstacles import Cylinders, World, make_obstacles
from jaxplan.world.polynomial import clearance_lower_bound
from tolerances import assert_close

pytestmark = pytest.mark.usefixtures("x64")

compiled = jax.jit(clearance_lower_bound, static_argnames=("pieces", "walls"))


def random_curves(rng: np.random.Generator, world: World, count: int, degree: int = 9) -> np.ndarray:
    """Curves across a part of the room with wiggles of up to a metre, ascending coefficients on [0, 1]."""
    lower, upper = np.asarray(world.bounds)
    nodes = np.linspace(0.0, 1.0, degree + 1)
    ends = rng.uniform(lower, upper, (2, count, 1, 3))
    shares = nodes[:, None]
    values = ends[0] * (1 - shares) + ends[1] * shares + rng.normal(scale=0.1, size=(count, degree + 1, 3))
    return np.linalg.solve(nodes[:, None] ** np.arange(degree + 1), values)


def sampled(curves: np.ndarray, samples: int) -> np.ndarray:
    powers = np.linspace(0.0, 1.0, samples)[:, None] ** np.arange(curves.shape[1])
    return np.einsum("sn,knd->ksd", powers, curves)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_never_above_a_dense_sampling(name: str) -> None:
    """10,000 random curves over the three worlds."""
    world, rng = load_world(name), np.random.default_rng(0)
    dense = jax.jit(lambda points: jnp.minimum(clearance(world, points), wall_clearance(world, points)))
    for _ in range(7):
        curves = random_curves(rng, world, 480)
        bound = np.asarray(compiled(world, curves))
        truth = np.concatenate([np.asarray(dense(points)).min(axis=1) for points in np.split(sampled(curves, 500), 8)])
        assert (bound <= truth + 1e-9).all()


def needles(rng: np.random.Generator, points: np.ndarray) -> World:
    """Vertical needles of 5 mm diameter through the given points."""
    count = len(points)
    cylinders = Cylinders(
        center=points,
        axis=np.tile([0.0, 0.0, 1.0], (count, 1)),
        radius=np.full(count, 0.0025),
        half_length=np.full(count, 2.0),
    )
    bounds = np.array([[-20.0, -20.0, -5.0], [20.0, 20.0, 5.0]])
    return World(name="needles", bounds=bounds, obstacles=make_obstacles(cylinders=cylinders), keep_in=np.float64(0.2))


def test_a_needle_between_samples_is_not_missed() -> None:
    """Each curve passes through a needle; most samplings at 17 places see nothing within 10 cm, the bound does."""
    rng, room = np.random.default_rng(1), load_world("env2")
    seen_by_samples = 0
    dense = jax.jit(clearance)
    for curve in random_curves(rng, room, 200):
        place = rng.uniform(0.05, 0.95)
        hit = (place ** np.arange(10)) @ curve
        world = needles(rng, hit[None])
        assert float(compiled(world, curve, walls=False)) <= 0.0
        seen_by_samples += float(np.asarray(dense(world, sampled(curve[None], 17))).min()) < 0.1
    assert seen_by_samples < 100


def test_more_pieces_are_tighter_and_approach_the_truth() -> None:
    world, rng = load_world("env3"), np.random.default_rng(2)
    curves = random_curves(rng, world, 50)
    points = sampled(curves, 4000)
    truth = np.minimum(np.asarray(clearance(world, points)), np.asarray(wall_clearance(world, points))).min(axis=1)
    gaps = [np.median(truth - np.asarray(compiled(world, curves, pieces=n))) for n in (8, 16, 32, 64)]
    assert gaps == sorted(gaps, reverse=True)
    assert gaps[-1] < 0.5 * gaps[0]


def test_a_curve_at_rest_has_its_point_s_clearance() -> None:
    world = load_world("env1")
    curve = np.zeros((10, 3))
    curve[0] = [0.3, 1.2, 0.7]
    assert_close(compiled(world, curve), min(float(clearance(world, curve[0])), 0.7), "formula")


def test_one_bad_lane_stays_alone() -> None:
    world = load_world("env1")
    curves = random_curves(np.random.default_rng(3), world, 6)
    good = np.asarray(compiled(world, curves))
    curves[2, 4, 1] = np.nan
    mixed = np.asarray(compiled(world, curves))
    assert np.isnan(mixed[2])
    keep = np.arange(6) != 2
    assert_close(mixed[keep], good[keep], "exact")
    assert_close(jax.vmap(lambda c: clearance_lower_bound(world, c))(jnp.asarray(curves))[keep], good[keep], "exact")


def test_gradient_is_finite_and_points_away() -> None:
    """Moving a whole curve along the gradient of its bound raises the bound."""
    world = load_world("env1")
    curves = jnp.asarray(random_curves(np.random.default_rng(4), world, 20))

    def shifted(offset: jax.Array, curve: jax.Array) -> jax.Array:
        return clearance_lower_bound(world, curve.at[0].add(offset))

    gradient = jax.jit(jax.vmap(jax.grad(shifted), (None, 0)))(jnp.zeros(3), curves)
    assert np.isfinite(gradient).all()
    ahead = jax.jit(jax.vmap(shifted))(1e-7 * gradient, curves) - compiled(world, curves)
    assert_close(np.median(ahead) / 1e-7, 1.0, "gradient")
