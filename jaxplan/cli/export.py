"""``jaxplan export``: what was planned, in the formats that other programs fly."""

import os
import sys
from pathlib import Path
from typing import Literal

from jaxplan.config import Frame


def export(
    source: Path,
    *,
    format: Literal["crazyswarm", "poly4d", "mav-trajectory-generation", "setpoints", "tum", "mcap"],
    out: Path,
    plan: int | None = None,
    frame: Frame = "enu",
    rate: float = 100.0,
    tolerance: float = 1e-3,
    debug: bool = False,
) -> int:
    """Write a committed plan, or all that was commanded in a flight, for other programs.

    Parameters
    ----------
    source
        The folder of an interception, or its plans.npz.
    format
        crazyswarm: CSV of degree 7, as uav_trajectories; poly4d: a Crazyflie's trajectory memory;
        mav-trajectory-generation: its YAML; setpoints: CSV of position to jerk and yaw; tum: poses, on the flight's
        clock; mcap: the whole episode for Foxglove, of a folder (needs the extra logs).
    out
        The file.
    plan
        Number of one committed plan, from 0; -1 is the last. Default: the whole flight, from plan to plan.
    frame
        enu: as planned, x east, y north, z up; ned: north, east, down.
    rate
        Setpoints or poses a second.
    tolerance
        How far [m] a trajectory of degree 7 may be from the planned one.
    debug
        Show the traceback of an error.
    """
    from jaxplan.errors import InputError
    from jaxplan.io.export import FORMATS, ExportConfig, export_trajectory
    from jaxplan.io.plans import commanded, read_plans

    if not os.path.isdir(out.parent):
        raise InputError(f"--out: have {str(out)!r}, want a file in a folder that exists; correct it")
    if format == "mcap":
        return _recording(source, out, plan, frame)
    plans = read_plans(source)
    if not plans:
        raise InputError(f"{source}: holds no plan, nothing was committed in that flight; choose another one")
    if plan is not None and not -len(plans) <= plan < len(plans):
        raise InputError(f"--plan: have {plan}, want -{len(plans)} to {len(plans) - 1}")
    start, spline = commanded(plans) if plan is None else plans[plan]
    found = export_trajectory(spline, format, ExportConfig(frame, rate, tolerance, start))
    _write(out, found.content)
    what = "samples" if FORMATS[format].read is None else "pieces"
    size = f"{found.pieces} {what}, {len(found.content)} bytes"
    print(f"{out}: {float(spline.duration):.3f} s from {start:.3f} s on, {size}")
    print(f"off by at most {found.error:.1e} m")
    return 0


def _recording(source: Path, out: Path, plan: int | None, frame: Frame) -> int:
    """Write a whole episode."""
    from jaxplan.errors import InputError
    from jaxplan.io.recording import record_episode

    if plan is not None or frame != "enu":
        raise InputError("--format mcap: have --plan or --frame ned, want neither: the whole episode is written, z up")
    found = record_episode(source)
    _write(out, found.content)
    for warning in found.warnings:
        print(f"jaxplan: warning: {warning}", file=sys.stderr)
    print(f"{out}: {found.messages} messages, {len(found.content)} bytes")
    return 0


def _write(out: Path, content: bytes) -> None:
    from jaxplan.files import cannot_write, write_atomically

    try:
        write_atomically(out, content)
    except OSError as error:
        raise cannot_write(out, error) from error
