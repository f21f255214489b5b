"""What tests of the MAVLink streamer share."""

import socket

import numpy as np

from jaxplan.spline import PiecewisePolynomial


def straight() -> PiecewisePolynomial:
    """A metre to the east and back to rest, turning a little: degree 7 and 5, by their closed forms."""
    position, yaw = np.zeros((1, 10, 3)), np.zeros((1, 6))
    position[0, 0], position[0, 4:8, 0] = [1.0, 2.0, 1.5], [35.0, -84.0, 70.0, -20.0]
    yaw[0, 3:6] = 0.5 * np.array([10.0, -15.0, 6.0])
    return PiecewisePolynomial(durations=np.array([1.5]), position=position, yaw=yaw)


def free_port() -> int:
    """Of UDP, on this machine, a moment ago."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
