"""The firmware as a process: started in a folder and, where the system allows, a network of its own; always ended."""

import contextlib
import functools
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from jaxplan.errors import ResourceError

from .build import Firmware
from .launcher import READY

LAUNCHER = Path(__file__).with_name("launcher.py")
OWN_NETWORK = ("unshare", "--net", "--map-root-user")
"""Of util-linux; in a user namespace of its own, so that it needs no privilege where the system allows these."""
START_SECONDS = 20.0
"""Within which the launcher has made its sockets (arbitrary)."""
LOG = "firmware.log"
"""What the firmware says, in its folder."""


class Sockets(NamedTuple):
    """The simulator's ends, all in the firmware's network."""

    inbound: socket.socket
    """UDP, bound to the motor port."""
    outbound: socket.socket
    """UDP, to send state and radio packets from."""
    commands: socket.socket
    """TCP, not yet connected."""


class Running(NamedTuple):
    """A firmware that runs."""

    sockets: Sockets
    process: subprocess.Popen
    folder: Path

    def condition(self) -> str:
        """Whether it runs, and the last line that it said: the end of an error message."""
        return _condition(self.process, self.folder)


@functools.cache
def has_own_network() -> bool:
    """Whether the system gives a process a network of its own."""
    if shutil.which(OWN_NETWORK[0]) is None:
        return False
    return subprocess.run((*OWN_NETWORK, "true"), capture_output=True, check=False).returncode == 0


@contextlib.contextmanager
def running(
    firmware: Firmware, folder: Path, boot: float | None, *, own_network: bool | None = None
) -> Iterator[Running]:
    """The firmware, from its start until the block is left, however it is left; then it is killed.

    Args:
        firmware: what to run.
        folder: where its settings are and its log goes.
        boot: seconds of its own clock after which it waits for its first packets; None: time is real.
        own_network: whether it gets one; else its ports on this machine's loopback must be free. None: if it can.

    Raises:
        ResourceError: it cannot be started, or a port is in use.
    """
    own_network = has_own_network() if own_network is None else own_network
    environment = {**os.environ, "JAXPLAN_PARENT": str(os.getpid())}
    environment.pop("JAXPLAN_BOOT_S", None)
    if boot is not None:
        environment["JAXPLAN_BOOT_S"] = repr(boot)
    here, there = socket.socketpair()
    with contextlib.ExitStack() as stack:
        stack.enter_context(here)
        log = stack.enter_context((folder / LOG).open("wb"))
        with there:
            python = (sys.executable, "-I", "-S", str(LAUNCHER), str(there.fileno()))
            files = (str(firmware.clock), str(firmware.program))
            process = subprocess.Popen(
                (*(OWN_NETWORK if own_network else ()), *python, "own" if own_network else "shared", *files),
                cwd=folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=[there.fileno()],
            )
        stack.callback(_end, process)
        sockets = _received(here, process, folder)
        for made in sockets:
            stack.enter_context(made)
        yield Running(sockets, process, folder)


def _received(channel: socket.socket, process: subprocess.Popen, folder: Path) -> Sockets:
    """The sockets from the launcher."""
    channel.settimeout(START_SECONDS)
    try:
        said, handles, _, _ = socket.recv_fds(channel, 256, 3)
    except TimeoutError as error:
        raise ResourceError(f"firmware: not started within {START_SECONDS:g} s; is the machine too busy?") from error
    if said == READY:
        return Sockets(*(socket.socket(fileno=handle) for handle in handles))
    process.wait()
    if not said:
        raise ResourceError(f"firmware: it could not be started; {_condition(process, folder)}")
    port, _, why = said.decode().partition(" ")
    if port == "0":
        raise ResourceError(f"firmware: its own network has no loopback ({why}); this system does not let it be put up")
    raise ResourceError(
        f"firmware: port {port} of 127.0.0.1 cannot be used ({why}); end what uses it, perhaps another firmware: its "
        "ports are fixed"
    )


def _condition(process: subprocess.Popen, folder: Path) -> str:
    code = process.poll()
    said = (folder / LOG).read_text(errors="replace").splitlines()
    last = next((line.strip() for line in reversed(said) if line.strip()), "nothing")
    return f"the process {'runs' if code is None else f'ended with code {code}'}; it said last: {last}"


def _end(process: subprocess.Popen) -> None:
    process.kill()
    process.wait()
