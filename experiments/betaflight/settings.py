"""The firmware's settings, made through its own command line once and kept beside the program."""

import contextlib
import hashlib
import subprocess
import tempfile
import time
from pathlib import Path

from jaxplan.errors import ResourceError

from .build import Firmware, one_at_a_time
from .launcher import COMMAND_PORT
from .link import LOOPBACK
from .process import Running, running

MOST_RATE = 670.0
"""Degrees per second of a full stick, about each axis."""
COMMANDS = (
    "aux 0 0 0 1700 2100 0 0",  # AUX1 arms
    "set small_angle = 180",  # in any attitude
    "set runaway_takeoff_prevention = OFF",  # it is let go in the air
    "set pid_process_denom = 8",  # rate loop at 1 kHz, gyroscope at 8 kHz
    "set rates_type = ACTUAL",
    *(f"set {axis}_rc_rate = {MOST_RATE / 10:.0f}" for axis in ("roll", "pitch", "yaw")),
    *(f"set {axis}_srate = {MOST_RATE / 10:.0f}" for axis in ("roll", "pitch", "yaw")),
    *(f"set {axis}_expo = 0" for axis in ("roll", "pitch", "yaw")),
)
"""Everything else is as Betaflight ships it, gains and filters of the rate loop included."""
MEMORY = "eeprom.bin"
"""The firmware's file, in the folder where it runs."""
PROMPT = b"# "
"""What ends an answer."""
PATIENCE = 30.0
"""s within which the firmware listens, answers and ends (arbitrary)."""
REFUSED = ("###ERROR", "Invalid", "Unknown")
"""How its command line says no."""


def settings_file(firmware: Firmware, commands: tuple[str, ...] = COMMANDS) -> Path:
    """The memory of a firmware that was given these commands, made now where it has not been made before.

    Raises:
        ResourceError: the firmware does not start, listen or end, or refuses a command.
    """
    digest = hashlib.sha256("\n".join(commands).encode()).hexdigest()[:16]
    path = firmware.program.with_name(f"settings-{digest}.bin")
    with one_at_a_time(path.parent):
        if not path.is_file():
            with tempfile.TemporaryDirectory(dir=path.parent) as folder:
                with running(firmware, Path(folder), boot=None) as process:
                    _tell(process, commands)
                (Path(folder) / MEMORY).replace(path)
    return path


def _tell(firmware: Running, commands: tuple[str, ...]) -> None:
    """Give the commands and ``save``, which ends the firmware."""
    _connect(firmware)
    line = firmware.sockets.commands
    line.settimeout(PATIENCE)
    line.sendall(b"#")  # alone: any byte after it takes it back
    _answer(firmware)
    for command in commands:
        line.sendall(f"{command}\n".encode())
        said = _answer(firmware)
        if any(word in said for word in REFUSED):
            raise ResourceError(f"firmware: its command line refuses {command!r}: {' '.join(said.split())}")
    line.sendall(b"save\n")
    with contextlib.suppress(subprocess.TimeoutExpired):
        firmware.process.wait(PATIENCE)
    if firmware.process.returncode != 0:
        raise ResourceError(f"firmware: it did not save its settings; {firmware.condition()}")


def _connect(firmware: Running) -> None:
    until = time.monotonic() + PATIENCE
    while True:
        try:
            firmware.sockets.commands.connect((LOOPBACK, COMMAND_PORT))
        except ConnectionRefusedError as error:
            if firmware.process.poll() is not None or time.monotonic() > until:
                raise ResourceError(
                    f"firmware: nobody listens on TCP port {COMMAND_PORT}; {firmware.condition()}"
                ) from error
            time.sleep(0.05)
        else:
            return


def _answer(firmware: Running) -> str:
    """What it says until it asks for the next command."""
    said = b""
    while not said.endswith(PROMPT):
        try:
            part = firmware.sockets.commands.recv(4096)
        except OSError as error:
            raise ResourceError(f"firmware: its command line is silent ({error}); {firmware.condition()}") from error
        if not part:
            raise ResourceError(f"firmware: its command line was closed; {firmware.condition()}")
        said += part
    return said.decode(errors="replace")
