"""How far a measured attitude is turned from the reference's, against rotations by SciPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxplan.vehicle.heading import heading_near, turn_from
from tolerances import relative


@pytest.mark.parametrize("seed", range(8))
def test_a_turn_about_body_z_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    yaw, tilt, turn = rng.uniform(-3.0, 3.0), rng.uniform(0.0, 1.0), rng.uniform(-1.5, 1.5)
    up = np.array([np.sin(tilt) * np.cos(2.0), np.sin(tilt) * np.sin(2.0), np.cos(tilt)])
    forward = np.cross([-np.sin(yaw), np.cos(yaw), 0.0], up)
    forward /= np.linalg.norm(forward)
    held = Rotation.from_matrix(np.stack([forward, np.cross(up, forward), up], axis=1))
    attitude = (held * Rotation.from_rotvec([0.0, 0.0, turn])).as_quat(scalar_first=True)
    assert turn_from(attitude, yaw) == pytest.approx(turn, **relative("formula"))
    level = Rotation.from_rotvec([0.0, 0.0, yaw]).as_quat(scalar_first=True)
    assert heading_near(level, yaw + 0.1) == pytest.approx(yaw, **relative("formula"))
