"""Rotor layouts without the symmetry of a cross."""

LAYOUTS = {
    "kite": (
        [[0.12, 0.06, 0.0], [0.07, -0.1, 0.01], [-0.09, -0.07, 0.0], [-0.06, 0.11, -0.01]],
        [1.0, -1.0, 1.0, -1.0],
    ),
    "triangle and centre": (
        [[0.1, 0.0, 0.0], [-0.05, -0.09, 0.0], [-0.05, 0.09, 0.0], [0.0] * 3],
        [1.0, 1.0, 1.0, -1.0],
    ),
    "spins by sides": (
        [[0.1, 0.06, 0.0], [0.1, -0.06, 0.0], [-0.1, -0.12, 0.0], [-0.1, 0.12, 0.0]],
        [1.0, -1.0, -1.0, 1.0],
    ),
}
"""Places [m] and spins. In the last, yaw has to be made against the reaction of the rotors."""
