"""The records of an MCAP file (mcap.dev/spec), each no larger than it may be (host).

``mcap`` (extra ``logs``) reads what is in a record. Where one ends and what a chunk unpacks to is looked after here, so
that a damaged or hostile file costs bounded memory.
"""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

from jaxplan.errors import FileError
from jaxplan.world.formats.streams import ByteStream

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE = 3, 4, 5
"""Kinds of records."""
_READ = (SCHEMA, CHANNEL, MESSAGE)
_FOOTER, _CHUNK = 2, 6
_LARGEST_PART = 64 * 2**20
"""Bytes of a record, and of a chunk when it is unpacked (arbitrary; writers make chunks of about 1 MB)."""


def records_of(path: Path, notes: list[str]) -> Iterator[tuple[int, Any]]:
    """Schemas, channels and messages in their order, chunks unpacked; ends where the file is cut off, with a note."""
    with path.open("rb") as stream:
        stream.seek(len(MAGIC))
        for kind, content in _frames(stream):
            if kind == _FOOTER:
                return
            if kind == _CHUNK:
                yield from (_parsed(*frame) for frame in _frames(BytesIO(_unpacked(content))) if frame[0] in _READ)
            else:
                yield _parsed(kind, content)
    notes.append("the file is cut off")


def _frames(stream: ByteStream) -> Iterator[tuple[int, bytes]]:
    """Kind and content of every record that is there whole; those that nobody here reads are passed over."""
    while len(head := stream.read(9)) == 9:
        kind, length = struct.unpack("<BQ", head)
        if kind == _CHUNK and length > _LARGEST_PART:
            raise FileError(f"has a chunk of {length} bytes, want at most {_LARGEST_PART}; is it damaged?")
        if kind not in (*_READ, _CHUNK, _FOOTER) or length > _LARGEST_PART:
            if not _passed(stream, length):
                return
            continue
        content = stream.read(length)
        if len(content) < length:
            return
        yield kind, content


def _passed(stream: ByteStream, length: int) -> bool:
    """Whether so many bytes could be passed over; a place beyond the end is one, too, one beyond all files is none."""
    try:
        stream.seek(length, 1)
    except (OSError, OverflowError, ValueError):
        return False
    return True


def _parsed(kind: int, content: bytes) -> tuple[int, Any]:
    from mcap import records
    from mcap.data_stream import ReadDataStream

    stream = ReadDataStream(BytesIO(content))
    try:
        if kind == MESSAGE:
            return kind, records.Message.read(stream, len(content))
        return kind, (records.Schema if kind == SCHEMA else records.Channel).read(stream)
    except Exception as error:  # whatever a damaged record raises
        raise FileError(f"has a record of kind {kind} that cannot be read ({type(error).__name__})") from error


def _unpacked(content: bytes) -> bytes:
    """What a chunk holds; no more than it says of itself, and no more than ``_LARGEST_PART``."""
    from mcap import records
    from mcap.data_stream import ReadDataStream

    try:
        chunk = records.Chunk.read(ReadDataStream(BytesIO(content)))
        most = min(chunk.uncompressed_size, _LARGEST_PART)
        found = _decompressed(chunk.compression, chunk.data, most + 1)
    except Exception as error:  # whatever a damaged chunk raises
        raise FileError(f"has a chunk that cannot be unpacked ({type(error).__name__}: {error})") from error
    if len(found) > most:
        raise FileError(f"has a chunk of more than {most} bytes, want no more; is it damaged?")
    return found


def _decompressed(compression: str, content: bytes, most: int) -> bytes:
    """At most so many bytes. Raises ``ValueError`` for another compression, others for damaged bytes."""
    if compression == "zstd":
        import zstandard

        reader = zstandard.ZstdDecompressor(max_window_size=_LARGEST_PART).stream_reader(BytesIO(content))
        return bytes(reader.read(most))
    if compression == "lz4":
        import lz4.frame

        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(content, max_length=most))
    if compression == "":
        return content
    raise ValueError(f"compression {compression[:20]!r}")
