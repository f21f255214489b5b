"""Starts the firmware in a network of its own: run as a program, before anything else is imported.

    python launcher.py FD own|shared LIBRARY PROGRAM

Makes the simulator's sockets, hands them to the starter through the Unix socket FD, and becomes PROGRAM with LIBRARY
loaded before it. With ``own`` the network is an empty one (as ``unshare --net`` makes it), whose loopback is put up
first: ports of other networks do not matter, and nobody outside reaches these. A socket stays in the network that it
was made in, whoever holds it.
"""

import fcntl
import os
import socket
import struct
import sys

MOTOR_PORT, STATE_PORT, RADIO_PORT, COMMAND_PORT = 9002, 9003, 9004, 5761
"""Where the firmware sends what the motors shall do; where it expects the vehicle's state, the sticks (UDP), and
commands (TCP)."""
SET_FLAGS, UP = 0x8914, 0x1
"""SIOCSIFFLAGS and IFF_UP of Linux."""
READY = b"ready"


def main(channel: int, network: str, library: str, program: str) -> None:
    """Never returns."""
    starter, port = socket.socket(fileno=channel), 0
    inbound, outbound = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    commands = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if network == "own":
            fcntl.ioctl(outbound, SET_FLAGS, struct.pack("16sh14x", b"lo", UP))
        for port, kind in ((STATE_PORT, "DGRAM"), (RADIO_PORT, "DGRAM"), (COMMAND_PORT, "STREAM")):
            check_free(port, getattr(socket, f"SOCK_{kind}"))
        port = MOTOR_PORT
        inbound.bind(("127.0.0.1", port))
    except OSError as error:
        starter.sendall(f"{port} {error.strerror}".encode())
        sys.exit(1)
    socket.send_fds(starter, [READY], [inbound.fileno(), outbound.fileno(), commands.fileno()])
    for opened in (starter, inbound, outbound, commands):
        opened.close()
    os.environ["LD_PRELOAD"] = library
    os.execv(program, [program])


def check_free(port: int, kind: int) -> None:
    """Raise ``OSError`` where the firmware could not listen: it would only say so, and go on."""
    with socket.socket(socket.AF_INET, kind) as trial:
        if kind == socket.SOCK_STREAM:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        trial.bind(("127.0.0.1", port))


if __name__ == "__main__":
    main(int(sys.argv[1]), *sys.argv[2:])
