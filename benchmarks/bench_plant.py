"""Closed-loop flights per second against batch size, beside C MuJoCo's threads and rotorpy.

    python -m benchmarks.bench_plant --batches 32 256 1024 --seconds 5

A flight is what ``jaxplan.track`` does with a spline: INDI at 200 Hz, physics at 400 Hz, rotor lag, drag and noise,
splines sampled in float64, errors compared with the thresholds. The peers do less: MuJoCo's threads step the same rigid
body in C under held thrusts, without rotors, drag, noise or controller; rotorpy flies its own SE(3) controller, one
flight at a time. The rigid body's own step stands beside the whole of mjx.step (docs/decisions/0016-free-body.md).
"""

import argparse
import os
import time
from pathlib import Path

import jax
import mujoco
import numpy as np
from mujoco import rollout

from jaxplan.minsnap.single import minimum_snap
from jaxplan.precision import float32_island
from jaxplan.tracking.model import Motion, complete_body, vehicle_body, vehicle_mjcf
from jaxplan.tracking.rates import PHYSICS_RATE
from jaxplan.tracking.track import TrackConfig, track
from jaxplan.vehicle.load import load_vehicle

from ._harness import write


def splines_of(count, seconds, rng):
    """Random rest-to-rest trajectories through four waypoints, ``seconds`` long."""
    chains = np.cumsum(rng.uniform(-2.0, 2.0, (min(count, 64), 4, 3)), axis=1)
    steps = np.linalg.norm(np.diff(chains, axis=1), axis=2)
    durations = seconds * steps / steps.sum(axis=1, keepdims=True)
    some = [minimum_snap(chain, duration) for chain, duration in zip(chains, durations, strict=True)]
    return [some[i % len(some)] for i in range(count)]


def flights(batch, seconds, controller, repeats):
    """Best of ``repeats`` runs of ``track``."""
    splines = splines_of(batch, seconds, np.random.default_rng(0))
    config = TrackConfig(controller=controller)
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        result = track(splines, config=config)
        times.append(time.perf_counter() - began)
    rate = batch / min(times)
    return {
        "method": f"track, {controller}",
        "batch": batch,
        "flights_per_s": rate,
        "feasible": float(result.feasible.mean()),
    }


def body_steps(batch, steps, repeats):
    """Steps per second of the rigid body alone, by its own stages of MJX and by the whole of mjx.step."""
    rng, rows = np.random.default_rng(0), []
    still = np.tile([1.0, 0.0, 0.0, 0.0], (batch, 1))
    motion = Motion(np.zeros((batch, 3)), still, rng.normal(size=(batch, 3)), rng.normal(size=(batch, 3)))
    thrusts, nothing = rng.uniform(1.0, 3.0, (batch, 4)), np.zeros((batch, 3))
    for method, body in (("free body", vehicle_body(load_vehicle())), ("mjx.step", complete_body(load_vehicle()))):
        many = jax.vmap(body)
        fly = float32_island(
            lambda motion, *loads, many=many: jax.lax.fori_loop(0, steps, lambda _, m: many(m, *loads), motion)
        )
        times = []
        for _ in range(repeats + 1):  # the first one compiles
            began = time.perf_counter()
            jax.block_until_ready(fly(motion, thrusts, nothing, nothing))
            times.append(time.perf_counter() - began)
        rows.append({"method": f"{method}, vmap", "batch": batch, "steps_per_s": batch * steps / min(times[1:])})
    return rows


def c_mujoco(batch, seconds, threads):
    """The rigid body alone, in C, open loop."""
    vehicle = load_vehicle()
    model = mujoco.MjModel.from_xml_string(vehicle_mjcf(vehicle))
    datas = [mujoco.MjData(model) for _ in range(threads)]
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    state = np.zeros(size)
    mujoco.mj_getState(model, datas[0], state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    steps = round(seconds * PHYSICS_RATE)
    control = np.full((batch, steps, 4), vehicle.mass * vehicle.gravity / 4)
    with rollout.Rollout(nthread=threads) as pool:
        began = time.perf_counter()
        pool.rollout(model, datas, np.tile(state, (batch, 1)), control)
        rate = batch / (time.perf_counter() - began)
    return {"method": f"C MuJoCo, body only, {threads} threads", "batch": batch, "flights_per_s": rate}


def rotorpy(count, seconds):
    """rotorpy's vehicle and SE(3) controller; None without the extra ``peers``."""
    try:
        from .peer_rotorpy import fly

        splines = splines_of(count, seconds, np.random.default_rng(0))
        began = time.perf_counter()
        for spline in splines:
            fly(load_vehicle(), spline)
        rate = count / (time.perf_counter() - began)
    except ImportError:
        rate = None
    return {"method": "rotorpy, SE(3)", "batch": 1, "flights_per_s": rate}


def main(argv=None):
    """Measure, print and write ``--json``."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batches", type=int, nargs="+", default=[32, 256, 1024])
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--peers", type=int, default=2, help="flights of rotorpy; 0 leaves it out")
    parser.add_argument("--json", type=Path, help="where the rows are saved")
    options = parser.parse_args(argv)
    threads = os.cpu_count() or 1
    compiling = {}
    for controller in ("indi", "se3"):
        began = time.perf_counter()
        track(splines_of(1, 0.2, np.random.default_rng(0)), config=TrackConfig(controller=controller))
        compiling[controller] = time.perf_counter() - began
    rows = []
    for batch in options.batches:
        rows.append(flights(batch, options.seconds, "indi", options.repeats))
        rows.append(c_mujoco(batch, options.seconds, threads))
    rows.append(flights(options.batches[-1], options.seconds, "se3", 1))
    if options.peers:
        rows.append(rotorpy(options.peers, options.seconds))
    steps = body_steps(options.batches[0], round(options.seconds * PHYSICS_RATE), options.repeats)
    for row in steps:
        print(f"{row['method']:36} batch {row['batch']:5}  {row['steps_per_s']:8.0f} steps of the body per second")
    for row in rows:
        rate = "-" if row["flights_per_s"] is None else f"{row['flights_per_s']:8.1f}"
        print(f"{row['method']:36} batch {row['batch']:5}  {rate} flights of {options.seconds:g} s per second")
    print(f"first call, with compilation: {compiling['indi']:.1f} s")
    if options.json is not None:
        compiled = [{"method": f"first call, {name}", "seconds": seconds} for name, seconds in compiling.items()]
        write(options.json, rows + steps + compiled)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
