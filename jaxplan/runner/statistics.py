"""Shares and their intervals."""

import math


def wilson(successes: int, count: int) -> tuple[float, float]:
    """The 95 % interval of a share (Wilson 1927, without continuity correction); (0, 1) for no trials."""
    if count == 0:
        return 0.0, 1.0
    z = 1.959964
    centre = (successes + 0.5 * z * z) / (count + z * z)
    half = z / (count + z * z) * math.sqrt(successes * (count - successes) / count + 0.25 * z * z)
    return max(0.0, centre - half), min(1.0, centre + half)
