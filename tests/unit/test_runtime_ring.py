"""Messages through shared memory: in order, whole or not at all."""

import multiprocessing
import zlib

import pytest

from jaxplan.runtime.ring import Ring, ring_bytes

ROWS, SIZE = 4, 40


def ring(memory=None):
    return Ring(memoryview(bytearray(ring_bytes(ROWS, SIZE)) if memory is None else memory), ROWS, SIZE)


def test_messages_come_in_order_and_the_oldest_give_way():
    messages = [bytes([k]) * (k % SIZE) for k in range(11)]
    one = ring()
    assert one.newest() is None
    for k, message in enumerate(messages):
        one.write(message)
        assert one.newest() == message
        assert one.written == k + 1
    assert list(one.since(0)) == list(enumerate(messages))[-ROWS:]
    assert list(one.since(9)) == list(enumerate(messages))[9:]
    assert one.read(6) is None
    assert one.read(11) is None


def test_a_message_that_is_too_long_is_refused_and_nothing_is_written():
    one = ring()
    one.write(b"first")
    with pytest.raises(ValueError, match="want at most 40"):
        one.write(bytes(SIZE + 1))
    assert one.newest() == b"first"
    assert one.written == 1


@pytest.mark.parametrize("written", range(0, 16 + SIZE, 3))
def test_a_row_whose_writer_was_killed_is_none(written):
    """Whatever part of the next row stands there: it is not there yet, and those before it are whole."""
    memory, after = bytearray(ring_bytes(ROWS, SIZE)), bytearray(ring_bytes(ROWS, SIZE))
    one, other = ring(memory), ring(after)
    for k in range(ROWS):
        one.write(bytes([k]) * SIZE)
        other.write(bytes([k]) * SIZE)
    other.write(b"\xff" * SIZE)
    memory[8 : 8 + written] = after[8 : 8 + written]
    assert [number for number, _ in one.since(0)] == ([1, 2, 3] if written else [0, 1, 2, 3])
    assert one.newest() == bytes([3]) * SIZE
    one.write(b"next")
    assert one.newest() == b"next"


def test_a_flipped_bit_is_seen():
    memory = bytearray(ring_bytes(ROWS, SIZE))
    one = ring(memory)
    one.write(b"a" * SIZE)
    memory[8 + 16 + 5] ^= 1
    assert one.newest() is None


def write_many(block, count):
    one = ring(memoryview(block).cast("B"))
    for k in range(count):
        one.write(k.to_bytes(8, "little") * (1 + k % 5))


def test_another_process_writes_and_every_message_read_is_whole():
    context, count = multiprocessing.get_context("spawn"), 200_000
    block = context.RawArray("B", ring_bytes(ROWS, SIZE))
    process = context.Process(target=write_many, args=(block, count))
    process.start()
    one, seen = ring(memoryview(block).cast("B")), []
    while one.written < count and process.exitcode in (None, 0):
        message = one.newest()
        if message is not None:
            seen.append(int.from_bytes(message[:8], "little"))
            assert message == message[:8] * (1 + seen[-1] % 5)
    process.join()
    assert process.exitcode == 0
    assert one.written == count
    assert seen == sorted(seen)
    assert zlib.crc32(b"") == 0, "an empty row of zeros is a whole empty message; its number keeps it out"
    assert ring().read(0) is None
