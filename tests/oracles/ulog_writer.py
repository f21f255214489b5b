"""ULog files from the format's specification (docs.px4.io, dev_log/ulog_file_format), for tests to read."""

import struct
from collections.abc import Iterable

MAGIC = b"ULog\x01\x12\x35\x01"
SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
CODES = {"uint64_t": "Q", "float": "f", "bool": "?", "uint8_t": "B", "double": "d", "int32_t": "i"}
LOCAL_POSITION = "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;bool xy_valid;bool z_valid;"
ODOMETRY = "uint64_t timestamp;float[3] position;uint8_t pose_frame;uint8_t[3] _padding0;"


def message(kind: str, content: bytes) -> bytes:
    return struct.pack("<HB", len(content), ord(kind)) + content


def header(flags: bytes = bytes(40)) -> bytes:
    """What every log begins with: magic, version, a time, and a message of flags and offsets."""
    return MAGIC + struct.pack("<Q", 1_000_000) + message("B", flags)


def definition(name: str, fields: str) -> bytes:
    return message("F", f"{name}:{fields}".encode())


def info(key: str, text: str) -> bytes:
    typed = f"char[{len(text)}] {key}".encode()
    return message("I", bytes([len(typed)]) + typed + text.encode())


def subscription(number: int, name: str, instance: int = 0) -> bytes:
    return message("A", struct.pack("<BH", instance, number) + name.encode())


def data(number: int, layout: str, *values: float) -> bytes:
    return message("D", struct.pack("<H", number) + struct.pack("<" + layout, *values))


def local_positions(number: int, rows: Iterable[tuple], valid: Iterable[bool]) -> list[bytes]:
    """Rows of seconds and x, y, z."""
    return [
        data(number, "QQfff??", round(1e6 * t), round(1e6 * t), x, y, z, ok, ok)
        for (t, x, y, z), ok in zip(rows, valid, strict=True)
    ]
