"""The checksum of the G1's low-level messages."""

import zlib

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
WORD_BYTES = 4


def checksum(data: bytes | memoryview) -> int:
    """CRC-32 of polynomial 0x04C11DB7, start 0xFFFFFFFF, no final inversion, over little-endian 32-bit words.

    Each word goes in from its highest bit to its lowest. zlib's CRC takes the bits of each byte from the lowest up,
    inverts its result and reflects it, so the words are byte-swapped, their bits reversed and the result undone.
    data: the C struct's bytes without the checksum itself. Raises ValueError unless whole words.
    """
    if len(data) % WORD_BYTES:
        raise ValueError(f"checksum: got {len(data)} bytes, expected a multiple of {WORD_BYTES}")
    swapped = bytearray(len(data))
    for byte in range(WORD_BYTES):
        swapped[byte::WORD_BYTES] = data[WORD_BYTES - 1 - byte :: WORD_BYTES]
    reflected = zlib.crc32(swapped.translate(_REVERSED)) ^ 0xFFFFFFFF
    return int.from_bytes(reflected.to_bytes(WORD_BYTES, "little").translate(_REVERSED), "big")
