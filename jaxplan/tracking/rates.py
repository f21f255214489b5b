"""How often the simulated vehicle is stepped and steered."""

PHYSICS_RATE = 400
"""Physics steps per second, as in the MFRL evaluation."""

CONTROL_RATE = 200
"""Control steps per second, as in the MFRL evaluation."""
