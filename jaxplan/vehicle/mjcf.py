"""Vehicles from a user's own MJCF, with one free body, four rotor sites and four actuators.

MuJoCo knows mass, inertia, places and the torque that goes with a thrust. What it does not know (thrust coefficient,
motor lag, drag, noise, gains) is taken from a base vehicle.
"""

import re
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from jaxplan.errors import FileError, InputError
from jaxplan.mjcf_probe import probe_mjcf
from jaxplan.records import replace
from jaxplan.vehicle.params import Vehicle
from jaxplan.vehicle.toml import preset

_MAX_BYTES = 2**20
"""Arbitrary, far above any vehicle."""
_REFUSED = re.compile(
    rb"<\s*(!DOCTYPE|!ENTITY|include|plugin|extension|hfield|replicate|composite|flexcomp|attach|mesh)"
)
"""What can read other files or grow without bound."""


def vehicle_from_mjcf(path: str | Path, *, base: Vehicle | None = None) -> Vehicle:
    """The vehicle of an MJCF file; what MJCF does not hold is as in ``base``, the MFRL vehicle when omitted.

    The actuators give rotor order, places and turning directions; all must have the same torque per thrust. Where they
    have a control range [N], its upper end sets the greatest rotor speed.

    Raises:
        FileError: the file cannot be read or compiled, or is no quadrotor with four upright rotors; a mixer that lacks
            rank is refused with its rank.
    """
    model = _compiled(Path(path))
    known = preset("mfrl") if base is None else base
    try:
        return _vehicle(model, known, Path(path).stem)
    except InputError as error:
        raise FileError(f"{path}: {error}") from error


def _compiled(path: Path) -> mujoco.MjModel:
    try:
        data = path.read_bytes() if path.stat().st_size <= _MAX_BYTES else None
    except OSError as error:
        raise FileError(f"Cannot read the vehicle file {path} ({error}): give a readable .xml file.") from error
    if data is None:
        raise FileError(f"{path}: larger than {_MAX_BYTES} bytes, want the MJCF of one vehicle; leave out its looks")
    found = _REFUSED.search(data)
    if found:
        raise FileError(f"{path}: have <{found[1].decode()}>, want one body with sites and actuators; remove it")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: have bytes that are not UTF-8 text, want MJCF; write it again") from error
    probe_mjcf(path, text, {})
    return mujoco.MjModel.from_xml_string(text)


def _vehicle(model: mujoco.MjModel, base: Vehicle, name: str) -> Vehicle:
    free = model.nv == 6 and model.njnt == 1 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    if not free or model.nbody != 2:
        raise InputError(
            f"have {model.nbody - 1} bodies and {model.nv} degrees of freedom, want one body, free, with 6"
        )
    at_sites = model.actuator_trntype == mujoco.mjtTrn.mjTRN_SITE
    if model.nu != 4 or not np.all(at_sites):
        raise InputError(f"have {int(np.sum(at_sites))} actuators at sites of {model.nu}, want 4, one for each rotor")
    to_principal = np.zeros(9)
    mujoco.mju_quat2Mat(to_principal, model.body_iquat[1])
    axes = np.abs(to_principal.reshape(3, 3))
    if not np.allclose(axes, np.round(axes), atol=1e-6):
        raise InputError("the principal axes of inertia are not those of the body, want a diagonal inertia")
    positions, torques = _rotors(model)
    ratio = float(np.mean(np.abs(torques)))
    if not ratio > 0.0 or not np.allclose(np.abs(torques), ratio, rtol=1e-6):
        raise InputError(
            f"the torques per thrust are {torques.tolist()} m, want +-the same, not 0 (gear, sixth number)"
        )
    changes = {
        "name": name,
        "mass": float(model.body_mass[1]),
        "inertia": np.round(axes) @ np.asarray(model.body_inertia[1]),
        "rotor_positions": positions,
        "rotor_spin": np.sign(torques),
        "torque_coefficient": ratio * float(base.thrust_coefficient),
        "gravity": float(-model.opt.gravity[2]),
    }
    if np.all(model.actuator_ctrllimited):
        most = float(np.min(model.actuator_ctrlrange[:, 1]))
        changes["rotor_speed_max"] = float(np.sqrt(most / float(base.thrust_coefficient)))
    return replace(base, **changes)


def _rotors(model: mujoco.MjModel) -> tuple[Float[np.ndarray, "4 3"], Float[np.ndarray, "4"]]:
    """Places from the centre of mass [m, body] and torque per thrust [m], rotor by rotor."""
    sites = model.actuator_trnid[:, 0]
    places, torques = model.site_pos[sites] - model.body_ipos[1], []
    for actuator, site in enumerate(sites):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.site_quat[site])
        force, torque = (turn.reshape(3, 3) @ part for part in np.split(model.actuator_gear[actuator], 2))
        if not np.allclose(force, [0.0, 0.0, 1.0], atol=1e-6) or not np.allclose(torque[:2], 0.0, atol=1e-9):
            raise InputError(f"actuator {actuator} pulls along {force.tolist()} (body), want upwards with gear 0 0 1")
        torques.append(float(torque[2]))
    return places, np.array(torques)
