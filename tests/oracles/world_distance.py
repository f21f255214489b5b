"""Signed distances to primitives and triangles, by other formulas than the library's and in NumPy."""

import numpy as np
from scipy.optimize import lsq_linear


def box(point: np.ndarray, center: np.ndarray, half: np.ndarray, rotation: np.ndarray) -> float:
    """Outside: the distance to the projection onto the box. Inside: minus the smallest distance to a face."""
    local = np.linalg.inv(rotation) @ (point - center)
    held = np.clip(local, -half, half)
    if (held != local).any():
        return float(np.linalg.norm(local - held))
    return -float(np.min(half - np.abs(local)))


def cylinder(point: np.ndarray, center: np.ndarray, axis: np.ndarray, radius: float, half_length: float) -> float:
    """By the nearest point of the solid, or of its surface from inside."""
    along = float(np.dot(point - center, axis))
    across = (point - center) - along * axis
    r = float(np.linalg.norm(across))
    if r <= radius and abs(along) <= half_length:
        return -min(radius - r, half_length - abs(along))
    nearest_across = across if r <= radius else across * (radius / r)
    nearest = center + np.clip(along, -half_length, half_length) * axis + nearest_across
    return float(np.linalg.norm(point - nearest))


def capsule(point: np.ndarray, center: np.ndarray, axis: np.ndarray, radius: float, half_length: float) -> float:
    """Distance to the nearest of the segment's two halves, minus the radius."""
    a, b = center - half_length * axis, center + half_length * axis
    fraction = np.clip(np.dot(point - a, b - a) / np.dot(b - a, b - a), 0.0, 1.0)
    return float(np.linalg.norm(point - (a + fraction * (b - a)))) - radius


def triangle(point: np.ndarray, corners: np.ndarray) -> float:
    """Distance to a triangle, as a bounded least-squares problem per case: the plane, then each edge."""
    best = np.inf
    for i in range(3):
        edge = corners[(i + 1) % 3] - corners[i]
        solution = lsq_linear(edge[:, None], point - corners[i], bounds=(0.0, 1.0))
        best = min(best, float(np.sqrt(2.0 * solution.cost)))
    basis = np.stack([corners[1] - corners[0], corners[2] - corners[0]], axis=1)
    weights, *_ = np.linalg.lstsq(basis, point - corners[0], rcond=None)
    if (weights >= 0.0).all() and weights.sum() <= 1.0:
        best = min(best, float(np.linalg.norm(corners[0] + basis @ weights - point)))
    return best
