"""MAVLink 2 from its specification (mavlink.io, serialization and common.xml), without any other code that knows it.

Fields go over the wire largest type first, extensions last; trailing zeros of the payload are cut; the checksum is
X.25 over the frame and a byte that stands for the definition itself.
"""

import struct
from typing import Any, NamedTuple

CODES = {
    "uint8_t": "B",
    "int16_t": "h",
    "uint16_t": "H",
    "int32_t": "i",
    "uint32_t": "I",
    "uint64_t": "Q",
    "float": "f",
}
SIZES = {kind: struct.calcsize(code) for kind, code in CODES.items()}

DEFINITIONS = {
    "HEARTBEAT": (
        0,
        "uint8_t type,uint8_t autopilot,uint8_t base_mode,uint32_t custom_mode,uint8_t system_status,"
        "uint8_t mavlink_version",
        "",
    ),
    "LOCAL_POSITION_NED": (32, "uint32_t time_boot_ms,float x,float y,float z,float vx,float vy,float vz", ""),
    "GLOBAL_POSITION_INT": (
        33,
        "uint32_t time_boot_ms,int32_t lat,int32_t lon,int32_t alt,int32_t relative_alt,int16_t vx,int16_t vy,"
        "int16_t vz,uint16_t hdg",
        "",
    ),
    "GPS_GLOBAL_ORIGIN": (49, "int32_t latitude,int32_t longitude,int32_t altitude", "uint64_t time_usec"),
    "COMMAND_LONG": (
        76,
        "uint8_t target_system,uint8_t target_component,uint16_t command,uint8_t confirmation,float param1,"
        "float param2,float param3,float param4,float param5,float param6,float param7",
        "",
    ),
    "COMMAND_ACK": (
        77,
        "uint16_t command,uint8_t result",
        "uint8_t progress,int32_t result_param2,uint8_t target_system,uint8_t target_component",
    ),
    "SET_POSITION_TARGET_LOCAL_NED": (
        84,
        "uint32_t time_boot_ms,uint8_t target_system,uint8_t target_component,uint8_t coordinate_frame,"
        "uint16_t type_mask,float x,float y,float z,float vx,float vy,float vz,float afx,float afy,float afz,"
        "float yaw,float yaw_rate",
        "",
    ),
    "ODOMETRY": (
        331,
        "uint64_t time_usec,uint8_t frame_id,uint8_t child_frame_id,float x,float y,float z,float[4] q,float vx,"
        "float vy,float vz,float rollspeed,float pitchspeed,float yawspeed,float[21] pose_covariance,"
        "float[21] velocity_covariance",
        "uint8_t reset_counter,uint8_t estimator_type",
    ),
}
"""Number, fields and extensions, as common.xml has them in order."""


class Field(NamedTuple):
    kind: str
    name: str
    count: int
    """0 for no array."""


class Message(NamedTuple):
    name: str
    system: int
    component: int
    sequence: int
    fields: dict[str, Any]


def fields_of(text: str) -> list[Field]:
    found = []
    for part in filter(None, text.split(",")):
        kind, name = part.split(" ")
        base, _, count = kind.rstrip("]").partition("[")
        found.append(Field(base, name, int(count or 0)))
    return found


def on_the_wire(name: str) -> tuple[list[Field], list[Field]]:
    """The fields in their order there, and the extensions."""
    _, fields, extensions = DEFINITIONS[name]
    return sorted(fields_of(fields), key=lambda field: -SIZES[field.kind]), fields_of(extensions)


def x25(content: bytes, crc: int = 0xFFFF) -> int:
    for byte in content:
        mixed = (byte ^ crc) & 0xFF
        mixed = (mixed ^ (mixed << 4)) & 0xFF
        crc = (crc >> 8) ^ (mixed << 8) ^ (mixed << 3) ^ (mixed >> 4)
    return crc & 0xFFFF


def extra(name: str) -> int:
    """The byte that stands for a definition."""
    crc = x25(f"{name} ".encode())
    for field in on_the_wire(name)[0]:
        crc = x25(f"{field.kind} {field.name} ".encode(), crc)
        if field.count:
            crc = x25(bytes([field.count]), crc)
    return (crc & 0xFF) ^ (crc >> 8)


def layout(name: str) -> struct.Struct:
    fields = [*on_the_wire(name)[0], *on_the_wire(name)[1]]
    return struct.Struct("<" + "".join(f"{field.count or ''}{CODES[field.kind]}" for field in fields))


def encode(name: str, system: int, component: int, sequence: int, **values: Any) -> bytes:
    """A frame; fields that are not given are 0."""
    flat: list[Any] = []
    for field in [*on_the_wire(name)[0], *on_the_wire(name)[1]]:
        value = values.get(field.name, [0] * field.count if field.count else 0)
        flat += list(value) if field.count else [value]
    payload = layout(name).pack(*flat).rstrip(b"\0") or b"\0"
    number = DEFINITIONS[name][0]
    head = struct.pack(
        "<BBBBBBHB", len(payload), 0, 0, sequence % 256, system, component, number & 0xFFFF, number >> 16
    )
    return b"\xfd" + head + payload + struct.pack("<H", x25(head + payload + bytes([extra(name)])))


def decode(frame: bytes) -> Message:
    """The message in a datagram of one frame; asserts that all of it is as specified."""
    assert frame[0] == 0xFD
    length, incompatible, _, sequence, system, component, low, high = struct.unpack("<BBBBBBHB", frame[1:10])
    assert incompatible == 0
    assert len(frame) == 12 + length
    name = {number: name for name, (number, _, _) in DEFINITIONS.items()}[low | high << 16]
    (crc,) = struct.unpack("<H", frame[-2:])
    assert crc == x25(frame[1:-2] + bytes([extra(name)]))
    flat = list(layout(name).unpack(frame[10:-2].ljust(layout(name).size, b"\0")))
    values = {}
    for field in [*on_the_wire(name)[0], *on_the_wire(name)[1]]:
        values[field.name] = [flat.pop(0) for _ in range(field.count)] if field.count else flat.pop(0)
    return Message(name, system, component, sequence, values)
