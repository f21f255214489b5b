"""UDP sockets by the names that MAVLink's tools give them: ``udpin:HOST:PORT`` and ``udpout:HOST:PORT``."""

import socket
from types import TracebackType

from jaxplan.errors import InputError, ResourceError

LARGEST_DATAGRAM = 65_535
_MOST_AT_ONCE = 1000
"""Datagrams taken in one go, so that a flood does not hold up what is to be sent (arbitrary)."""


class Endpoint:
    """One end of a UDP link. ``udpin`` listens and answers whoever spoke last; ``udpout`` speaks to one address."""

    def __init__(self, name: str) -> None:
        """Open it.

        Raises:
            InputError: ``name`` is none. ResourceError: the port is in use, or the host unknown.
        """
        self.name = name
        self._peer: tuple[str, int] | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._open()
        except (InputError, ResourceError):
            self._socket.close()
            raise

    def _open(self) -> None:
        kind, host, port = _parts(self.name)
        try:
            address = (socket.gethostbyname(host), port)
            if kind == "udpin":
                self._socket.bind(address)
            else:
                self._peer = address
        except OSError as error:
            raise ResourceError(f"{self.name}: {error.strerror}; choose another host or port") from error

    def __enter__(self) -> "Endpoint":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def port(self) -> int:
        """On this machine."""
        return int(self._socket.getsockname()[1])

    @property
    def reachable(self) -> bool:
        """Whether there is anyone to speak to."""
        return self._peer is not None

    def fileno(self) -> int:
        """For ``select``."""
        return self._socket.fileno()

    def send(self, content: bytes) -> bool:
        """Whether it went out; a link that is down is no error, it may come back."""
        if self._peer is None:
            return False
        try:
            self._socket.sendto(content, self._peer)
        except OSError:
            return False
        return True

    def receive(self) -> list[bytes]:
        """The datagrams that have come."""
        found: list[bytes] = []
        while len(found) < _MOST_AT_ONCE:
            try:
                content, sender = self._socket.recvfrom(LARGEST_DATAGRAM)
            except BlockingIOError:
                break
            except OSError:  # nobody listens at the other end yet
                continue
            found.append(content)
            if self.name.startswith("udpin"):
                self._peer = sender
        return found

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()


def _parts(name: str) -> tuple[str, str, int]:
    """The three parts of a name."""
    kind, _, rest = name.partition(":")
    host, _, port = rest.rpartition(":")
    if kind not in ("udpin", "udpout") or not host or not port.isdecimal() or not 0 < int(port) < 65_536:
        raise InputError(f"have {name!r}, want udpin:HOST:PORT to listen or udpout:HOST:PORT to speak first")
    return kind, host, int(port)
