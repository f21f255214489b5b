"""Messages through memory that two processes share: one writes, the other reads, and neither ever waits.

A writer that is killed in the middle of a row leaves one that its checksum refuses; a reader that is too slow loses the
oldest rows and is told so.
"""

import struct
import zlib
from collections.abc import Iterator

_HEAD = 8
"""Bytes before the first row: how many were written, in one aligned word, which a processor writes whole."""
_ROW = struct.Struct("<QII")
"""Before each row: its number, its length [bytes], its checksum."""


def ring_bytes(rows: int, size: int) -> int:
    """What a ring of ``rows`` messages of at most ``size`` bytes takes [bytes], a multiple of 8."""
    return _HEAD + rows * _stride(size)


class Ring:
    """The last messages of one process to another, numbered from 0."""

    def __init__(self, memory: memoryview, rows: int, size: int) -> None:
        """``memory`` has ``ring_bytes(rows, size)`` bytes, zeros at first."""
        self._memory, self._rows, self._size = memory, rows, size
        self._head = memory[:_HEAD].cast("Q")

    @property
    def written(self) -> int:
        """How many messages were written so far."""
        return int(self._head[0])

    def write(self, message: bytes) -> None:
        """Add a message, in the place of the oldest where all are taken. Raises ``ValueError`` if it is too long."""
        if len(message) > self._size:
            raise ValueError(f"ring: a message has {len(message)} bytes, want at most {self._size}")
        number = self.written
        place = self._place(number)
        _ROW.pack_into(self._memory, place, number, len(message), zlib.crc32(message))
        self._memory[place + _ROW.size : place + _ROW.size + len(message)] = message
        self._head[0] = number + 1

    def read(self, number: int) -> bytes | None:
        """Message ``number``; None where it is not there yet, not any more, or damaged."""
        place = self._place(number)
        found, length, checksum = _ROW.unpack_from(self._memory, place)
        if found != number or length > self._size or not number < self.written:
            return None
        message = bytes(self._memory[place + _ROW.size : place + _ROW.size + length])
        return message if zlib.crc32(message) == checksum else None

    def newest(self) -> bytes | None:
        """The last message; None where there is none, or it is damaged."""
        return self.read(self.written - 1) if self.written else None

    def since(self, number: int) -> Iterator[tuple[int, bytes]]:
        """The messages from ``number`` on that are still there, each with its number."""
        written = self.written
        for each in range(max(number, written - self._rows), written):
            message = self.read(each)
            if message is not None:
                yield each, message

    def _place(self, number: int) -> int:
        return _HEAD + number % self._rows * _stride(self._size)


def _stride(size: int) -> int:
    """Bytes from one row to the next, a multiple of 8."""
    return -(-(_ROW.size + size) // 8) * 8
