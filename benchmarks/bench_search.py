"""Search and knots for 400 candidates: how long the paths are, how long they take, what a world's preparation takes.

    jaxplan bench search [--json FILE] [--maps FILE ...]

Quality: lengths of paths between random free points that do not see each other, as an excess over the reference, taut
paths of the 0.1 m lattice searched without a budget; and how many goals that the reference reaches are missed. The
paper's rule ("multi-resolution") stands beside the roadmap.

Time: the cycles of a pursuit, against SciPy's Dijkstra and scikit-image's MCP.

Updates: a box appears, and what is prepared is patched.

Each cycle puts the defender at a random share of the way to a stored target, so that all distances between the drones
occur, and asks for routes to 20 predicted positions of the target with 20 noisy copies of each. The peers solve the
same cycle on the lattice of the paper's rule, all goals in one search; they have no knots to select and no start or
goal off the lattice. scikit-image belongs to the extra ``peers``; without it its rows are missing. The last row is the
exact clearance of 400 trajectories of 100 samples in environment 3. The peers take long and solve the first few
cycles only; every row says how many it comes from.
"""

import argparse
import importlib.util
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from jaxplan.io.targets import load_target, stored_targets
from jaxplan.knots import KnotConfig, select_routes
from jaxplan.precision import in_float64
from jaxplan.prediction.protocol import PredictionConfig
from jaxplan.search.kernels.graph import LENGTHS, STEPS
from jaxplan.search.lattice import SearchConfig, build_lattices, choose_level
from jaxplan.search.routes import find_routes, warmup
from jaxplan.search.update import update_lattices
from jaxplan.selection import CheckConfig
from jaxplan.vehicle.load import load_vehicle
from jaxplan.world.clearance import clearance
from jaxplan.world.load import ENVIRONMENTS, load_world
from jaxplan.world.occupancy import exact_clearance
from jaxplan.world.update import update_world, with_spare_boxes

from . import _harness

CAPACITY = 32
REFERENCE = SearchConfig(
    method="multi-resolution", resolutions=(0.1,), distance_fractions=(), first_budget=10**8, last_budget=10**8
)
GOALS_A_START = 100


def cycles(name, world, lattices, count, rng):
    """Pairs of a defender's position [m] and 400 goals [m]."""
    names = stored_targets(name)
    while count > 0:
        target = load_target(names[rng.integers(len(names))], world=name, speed=rng.uniform(0.5, 5.5))
        times = rng.uniform(0.0, target.duration) + PredictionConfig.for_world(world).offsets
        goals = target.position(times)
        route = find_routes(lattices, world, world.start, goals[:1], 1e9)
        if route.reasons[0]:
            continue
        share, points = rng.uniform(), route.points[0, : route.count[0]]
        travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        start = np.array([np.interp(share * travelled[-1], travelled, points[:, axis]) for axis in range(3)])
        noise = rng.normal(scale=0.01 * np.sqrt(np.arange(1, 21))[:, None, None], size=(20, 20, 3))
        yield start, (goals[:, None] + noise).reshape(-1, 3), goals[0]
        count -= 1


def lattice_edges(lattices, level):
    """The lattice as a sparse matrix [m], built once per map."""
    lattice = lattices.levels[level]
    shape = np.array(lattice.grid.shape)
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    rows, columns, lengths = [], [], []
    for bit in range(26):
        cells = np.flatnonzero(lattice.moves >> np.uint32(bit) & np.uint32(1))
        rows.append(cells)
        columns.append(cells + STEPS[bit] @ strides)
        lengths.append(np.full(len(cells), LENGTHS[bit] * lattice.grid.resolution))
    entries = (np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns)))
    return coo_array(entries, shape=(len(lattice.moves),) * 2).tocsr()


def cells_of(grid, points):
    """Indices of the cells that hold the points [m]."""
    index = np.floor((points - grid.origin) / grid.resolution).astype(int)
    return np.clip(index, 0, np.array(grid.shape) - 1)


def scipy_paths(edges, grid, start, goals):
    """Dijkstra from the start's cell, and the walk back from every goal's cell."""
    source = int(np.ravel_multi_index(tuple(cells_of(grid, start)), grid.shape))
    ends = np.ravel_multi_index(tuple(cells_of(grid, goals).T), grid.shape)
    _, before = dijkstra(edges, indices=source, return_predecessors=True)
    paths = []
    for end in ends:
        path = [end]
        while before[path[-1]] >= 0:
            path.append(before[path[-1]])
        paths.append(path)
    return paths


def image_paths(grid, start, goals):
    """scikit-image's geometric minimum cost paths; they cut corners."""
    from skimage.graph import MCP_Geometric

    search = MCP_Geometric(np.where(grid.occupied, -1.0, 1.0), fully_connected=True)
    ends = np.unique(cells_of(grid, goals), axis=0)
    ends = ends[~grid.occupied[tuple(ends.T)]]
    costs, _ = search.find_costs([tuple(cells_of(grid, start))], [tuple(end) for end in ends])
    return [search.traceback(tuple(end)) for end in ends if np.isfinite(costs[tuple(end)])]


def milliseconds(function, *arguments):
    """Wall time of one call."""
    began = time.perf_counter()
    jax.block_until_ready(function(*arguments))
    return 1e3 * (time.perf_counter() - began)


@in_float64
def measure(name, method, count, peers, seed):
    """One row per method with the times of one world's cycles, and one with the times of preparing."""
    world, rng = load_world(name), np.random.default_rng(seed)
    began = time.perf_counter()
    lattices = build_lattices(world, SearchConfig(method=method))
    built = time.perf_counter()
    warmup(lattices, world, CAPACITY)
    warm = time.perf_counter()
    knots = jax.jit(lambda paths: select_routes(paths, KnotConfig()))
    jax.block_until_ready(knots(np.zeros((400, CAPACITY, 3))))
    times = {"routes": [], "knots": [], "routes + knots": [], "scipy": [], "skimage": []}
    edges = {}
    for number, (start, goals, target) in enumerate(cycles(name, world, lattices, count, rng)):
        distance = float(np.linalg.norm(target - start))
        times["routes"].append(milliseconds(find_routes, lattices, world, start, goals, distance, CAPACITY))
        routes = find_routes(lattices, world, start, goals, distance, CAPACITY)
        times["knots"].append(milliseconds(knots, routes.points))
        times["routes + knots"].append(times["routes"][-1] + times["knots"][-1])
        level = choose_level(lattices, distance, world.diagonal)
        if number < peers:
            if level not in edges:
                edges[level] = lattice_edges(lattices, level)
            grid = lattices.levels[level].grid
            times["scipy"].append(milliseconds(scipy_paths, edges[level], grid, start, goals))
            if importlib.util.find_spec("skimage"):
                times["skimage"].append(milliseconds(image_paths, grid, start, goals))
    head = {"world": name, "search": method}
    prepared = {**head, "method": "prepare", "build_s": built - began, "warmup_s": warm - built}
    return [prepared, *({**head, "method": key, **quantiles(ms)} for key, ms in times.items() if ms)]


def free_points(world, count, rng):
    """Points [m] that keep the paper's padding and the room's margin."""
    low, high = np.asarray(world.bounds) + float(world.keep_in) * np.array([[1.0], [-1.0]])
    found = np.zeros((0, 3))
    while len(found) < count:
        points = rng.uniform(low, high, (1024, 3))
        found = np.concatenate([found, points[exact_clearance(world.obstacles, points) >= REFERENCE.padding]])
    return found[:count]


def size_of(roadmap):
    """Megabytes of a roadmap's arrays."""
    return sum(leaf.nbytes for leaf in jax.tree.leaves(roadmap) if isinstance(leaf, np.ndarray)) / 1e6


@in_float64
def measure_quality(name, pairs, seed):
    """One row per method: excess over the reference, goals missed, preparation, memory, 400 goals around one place."""
    world, rng = load_world(name), np.random.default_rng(seed)
    reference, rows = build_lattices(world, REFERENCE), []
    starts = free_points(world, max(pairs // GOALS_A_START, 1), rng)
    queries = [(start, free_points(world, GOALS_A_START, rng)) for start in starts]
    best = [find_routes(reference, world, start, goals, 1.0, 64) for start, goals in queries]
    for method in ("roadmap", "multi-resolution"):
        build_lattices(world, SearchConfig(method=method))
        began = time.perf_counter()
        lattices = build_lattices(world, SearchConfig(method=method))
        built = time.perf_counter() - began
        warmup(lattices, world, 64)
        shares, missed, reached, times = [], 0, 0, []
        for (start, goals), one in zip(queries, best, strict=True):
            distance = float(np.linalg.norm(goals - start, axis=1).mean())
            found = find_routes(lattices, world, start, goals, distance, 64)
            there = one.reasons == 0
            bent = there & (found.reasons == 0) & (one.length > np.linalg.norm(goals - start, axis=1) + 1e-9)
            shares.append(found.length[bent] / one.length[bent] - 1.0)
            missed, reached = missed + int((there & (found.reasons != 0)).sum()), reached + int(there.sum())
            cloud = goals[np.argmax(there)] + rng.normal(scale=[0.3, 0.3, 0.1], size=(400, 3))
            times.append(milliseconds(find_routes, lattices, world, start, cloud, distance, CAPACITY))
        share = np.concatenate(shares)
        p90, p99 = np.quantile(share, [0.9, 0.99])
        excess = {"mean": share.mean(), "p90": p90, "p99": p99, "worst": share.max()}
        rows.append(
            {
                "world": Path(name).stem,
                "search": method,
                "method": "quality",
                "pairs": len(share),
                **{f"excess_{key}_percent": 100.0 * float(value) for key, value in excess.items()},
                "missed": f"{missed} of {reached}",
                "build_s": built,
                "memory_mb": size_of(lattices.roadmap),
                "p50_ms": float(np.median(times)),
                "max_ms": float(np.max(times)),
            }
        )
    return rows


@in_float64
def measure_updates(name, count, seed):
    """One row: a box of 0.4 to 1 m appears anywhere in the room, and the planner's roadmap is patched."""
    world, rng = with_spare_boxes(load_world(name), 1), np.random.default_rng(seed)
    least = float(load_vehicle().radius) + CheckConfig().tracking_margin
    lattices = build_lattices(world, SearchConfig(resolutions=(0.1,), distance_fractions=(), least_padding=least))
    low, high = np.asarray(world.bounds)
    times = []
    for _ in range(count + 1):
        middle, half = rng.uniform(low, high), rng.uniform(0.2, 0.5, 3)
        change = update_world(world, add_box=(middle - half, middle + half))
        times.append(milliseconds(update_lattices, lattices, change))
    return {"world": name, "search": "roadmap", "method": "update", **quantiles(times[1:])}


def quantiles(values):
    """Median, 99th percentile and maximum [ms]."""
    p50, p99 = np.quantile(values, [0.5, 0.99])
    return {"cycles": len(values), "p50_ms": float(p50), "p99_ms": float(p99), "max_ms": float(np.max(values))}


@in_float64
def measure_clearance(repeats):
    """The exact clearance of 400 x 100 random points of environment 3."""
    world = load_world("env3")
    points = jnp.asarray(np.random.default_rng(0).uniform(*world.bounds, (400, 100, 3)))
    row = _harness.timed(jax.jit(clearance), world, points, repeats=repeats)
    return {"world": "env3", "method": "clearance of 400 x 100 points", **row}


def main(argv=None):
    """Measure, print and, where asked, write the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=200)
    parser.add_argument("--peers", type=int, default=10, help="cycles that the peers solve too")
    parser.add_argument("--worlds", nargs="+", default=list(ENVIRONMENTS))
    parser.add_argument("--maps", nargs="*", default=[], help="map files whose paths are looked at too")
    parser.add_argument("--pairs", type=int, default=2000, help="pairs of points by which paths are judged")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(argv)
    rows = []
    for name in [*options.worlds, *options.maps]:
        rows += measure_quality(name, options.pairs, options.seed)
    for name in options.worlds:
        rows.append(measure_updates(name, options.cycles, options.seed))
        for method, peers in (("roadmap", options.peers), ("multi-resolution", 0)):
            rows += measure(name, method, options.cycles, peers, options.seed)
    rows.append(measure_clearance(repeats=options.cycles))
    _harness.show(rows)
    if options.json:
        _harness.write(options.json, rows)
    return rows


if __name__ == "__main__":
    main()
