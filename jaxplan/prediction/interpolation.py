"""Positions between samples of uneven spacing."""

import numpy as np
from jaxtyping import Float


def interpolate(
    times: Float[np.ndarray, "n"], values: Float[np.ndarray, "n c"], at: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m c"]:
    """Piecewise cubics through all samples, with the slopes of parabolas through three neighbours; held at the ends.

    Exact for parabolas; its error is of third order in the interval, of fourth where samples are even.

    Args:
        times: increasing [s], at least one.
        values: at these times.
        at: where values are wanted [s].
    """
    if len(times) == 1:
        return np.repeat(values, len(at), axis=0)
    interval = np.diff(times)[:, None]
    chord = np.diff(values, axis=0) / interval
    slopes = np.concatenate([chord[:1], chord])
    if len(times) > 2:
        before, after = interval[:-1], interval[1:]
        slopes[1:-1] = (after * chord[:-1] + before * chord[1:]) / (before + after)
        slopes[0], slopes[-1] = 2.0 * chord[0] - slopes[1], 2.0 * chord[-1] - slopes[-2]
    piece = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(interval) - 1)
    h = interval[piece]
    s = np.clip((at - times[piece])[:, None] / h, 0.0, 1.0)
    first, step = values[piece], values[piece + 1] - values[piece]
    bend = (1.0 - s) * (h * slopes[piece] - step) - s * (h * slopes[piece + 1] - step)
    return first + s * step + s * (1.0 - s) * bend
