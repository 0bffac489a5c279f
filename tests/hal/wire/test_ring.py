"""The newest record, whole or not at all."""

import subprocess
import sys

import numpy as np
import pytest

from hal.wire.ring import HEADER_BYTES, SLOTS, Ring, SharedMemory


def make(capacity=64):
    buffer = memoryview(bytearray(Ring.size(capacity)))
    return Ring(buffer, capacity), Ring(buffer, capacity), buffer


def test_the_newest_record_is_read():
    writer, reader, _ = make()
    assert reader.latest() is None
    for serial in range(1, 3 * SLOTS):
        writer.publish(b"x" * serial)
        assert reader.latest() == (serial, b"x" * serial)


def test_a_writer_that_stops_half_way_leaves_the_record_before(monkeypatch):
    writer, reader, buffer = make()
    writer.publish(b"first")
    writer.publish(b"second")
    stride = (len(buffer) - HEADER_BYTES) // SLOTS
    start = HEADER_BYTES + 3 * stride  # slot of serial 3, begun and not published
    buffer[start : start + stride] = bytes([7]) * stride
    assert reader.latest() == (2, b"second")


def test_a_damaged_record_is_none():
    writer, reader, buffer = make()
    writer.publish(b"value")
    stride = (len(buffer) - HEADER_BYTES) // SLOTS
    buffer[HEADER_BYTES + stride + 32] ^= 1
    assert reader.latest() is None


def test_a_record_that_is_too_long_is_refused():
    writer, _, _ = make(16)
    with pytest.raises(ValueError, match="17 bytes"):
        writer.publish(bytes(17))


CHILD = """
import sys, time
import numpy as np
from hal.wire.ring import Ring, SharedMemory
memory = SharedMemory(int(sys.argv[1]), int(sys.argv[2]))
ring = Ring(memory.buffer, 2048)
end_s = time.monotonic() + 0.5
value = 0
while time.monotonic() < end_s:
    value += 1
    ring.publish(np.full(256, float(value)).tobytes())
"""


def test_never_torn_and_never_back_between_processes():
    memory = SharedMemory.create(Ring.size(2048))
    ring = Ring(memory.buffer, 2048)
    call = [sys.executable, "-c", CHILD, str(memory.fd), str(memory.size)]
    child = subprocess.Popen(call, pass_fds=[memory.fd])
    seen = []
    while child.poll() is None:
        if (latest := ring.latest()) is not None:
            values = np.frombuffer(latest[1])
            assert (values == values[0]).all()
            seen.append((latest[0], values[0]))
    assert child.returncode == 0
    assert len(set(seen)) > 3 and seen == sorted(seen)
    assert all(serial == value for serial, value in seen)


def test_the_memory_outlives_its_descriptor():
    memory = SharedMemory.create(4096)
    memory.close_descriptor()
    memory.close_descriptor()
    memory.buffer[0] = 1
    assert memory.buffer[0] == 1
