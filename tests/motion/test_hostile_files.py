"""Damaged and malicious clip files: one error that names file and field, nothing run, no memory spent."""

import io
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest

from core.errors import InputError
from motion.clip import Clip, clip_from_bytes, clip_to_bytes, load_clip


@pytest.fixture
def members(fields) -> dict[str, bytes]:
    """The .npy members of a valid clip by name."""
    with zipfile.ZipFile(io.BytesIO(clip_to_bytes(Clip(**fields)))) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method, compresslevel=1) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def npy(array: np.ndarray, allow_pickle: bool = False) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, allow_pickle=allow_pickle)
    return buffer.getvalue()


def npy_header(text: str) -> bytes:
    padded = text.encode() + b" " * (-len(text) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(padded)) + padded


def test_the_untouched_members_load(members):
    assert clip_from_bytes(packed(members)).num_frames == 5


def test_missing_and_unknown_fields(members):
    members["colour.npy"] = members.pop("contact.npy")
    with pytest.raises(InputError, match=r"a\.npz: wrong fields, got unknown colour; missing contact"):
        clip_from_bytes(packed(members), "a.npz")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_field_twice(members):
    buffer = io.BytesIO(packed(members))
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.writestr("contact.npy", members["contact.npy"])
    with pytest.raises(InputError, match="contact: field appears twice"):
        clip_from_bytes(buffer.getvalue())


class _Payload:
    """Writes a marker file when unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def test_object_array_runs_nothing(members, tmp_path):
    marker = tmp_path / "ran"
    members["contact.npy"] = npy(np.array([_Payload(marker)], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="contact: type not allowed, got type object"):
        clip_from_bytes(packed(members))
    assert not marker.exists()


@pytest.mark.parametrize("dtype", ["O", "V8", "M8[s]", "S4", "c16", "(3,)f8", "f8,f8"])
def test_types_without_numbers_or_text(members, dtype):
    members["contact.npy"] = npy(np.zeros((5, 2), dtype=dtype), allow_pickle=True)
    with pytest.raises(InputError, match="contact"):
        clip_from_bytes(packed(members))


HEADERS = {
    "huge": "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 2), }",
    "product wraps to zero": "{'descr': '<f8', 'fortran_order': False, 'shape': (4294967296, 4294967296), }",
    "negative": "{'descr': '<f8', 'fortran_order': False, 'shape': (-5, -2), }",
    "empty with huge side": "{'descr': '<f8', 'fortran_order': False, 'shape': (0, 10000000000000000000000), }",
    "no numbers": "{'descr': '<f8', 'fortran_order': False, 'shape': ('5', 2), }",
    "call": "{'descr': __import__('os').getcwd(), 'fortran_order': False, 'shape': (5, 2), }",
    "nested": "(" * 5000,
    "minus": "-" * 9000 + "1",
    "not a dict": "[1, 2]",
}


@pytest.mark.parametrize("header", HEADERS.values(), ids=HEADERS)
def test_lying_header_allocates_nothing(members, header):
    members["contact.npy"] = npy_header(header) + bytes(80)
    content = packed(members)
    tracemalloc.start()
    with pytest.raises(InputError, match="contact"):
        clip_from_bytes(content)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()


def test_zip_bomb_is_refused_before_it_unpacks(members):
    members["contact.npy"] = bytes(300 * 2**20)
    content = packed(members)
    members.clear()
    tracemalloc.start()
    with pytest.raises(InputError, match="contact: too large unpacked"):
        clip_from_bytes(content)
    assert tracemalloc.get_traced_memory()[1] < 50e6
    tracemalloc.stop()


def test_every_truncation_is_one_error(fields, tmp_path):
    content = clip_to_bytes(Clip(**fields))
    path = tmp_path / "cut.npz"
    for length in [*range(0, len(content), 97), len(content) - 1]:
        path.write_bytes(content[:length])
        with pytest.raises(InputError, match=r"cut\.npz"):
            load_clip(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_flipped_bytes_give_a_clip_or_one_error(members, method):
    content = packed(members, method)
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(400):
        damaged = bytearray(content)
        for position in rng.integers(0, len(content), 3):
            damaged[position] ^= int(rng.integers(1, 256))
        try:
            clip_from_bytes(bytes(damaged))
        except InputError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > 200


def test_other_packing_methods_and_garbage(members, tmp_path):
    for content in (packed(members, zipfile.ZIP_LZMA), packed(members, zipfile.ZIP_BZIP2), b"PK\x03\x04", b"text" * 50):
        with pytest.raises(InputError):
            clip_from_bytes(content)
    with pytest.raises(InputError, match="no such file"):
        load_clip(tmp_path / "none.npz")
    with pytest.raises(InputError, match="is no file"):
        load_clip(tmp_path)


def test_large_file_is_not_read(tmp_path):
    path = tmp_path / "large.npz"
    with path.open("wb") as file:
        file.truncate(300 * 2**20)
    with pytest.raises(InputError, match="file too large"):
        load_clip(path)


def test_text_that_is_no_text(members):
    members["source.npy"] = npy_header("{'descr': '<U1', 'fortran_order': False, 'shape': (), }") + b"\xff\xff\xff\xff"
    with pytest.raises(InputError, match="source"):
        clip_from_bytes(packed(members))


def test_scalars_of_the_wrong_shape(members):
    for name, array in {"fps": np.array([30.0]), "joint_names": np.array("hip"), "source": np.array(3.0)}.items():
        with pytest.raises(InputError, match=f"{name}: wrong shape or type"):
            clip_from_bytes(packed(members | {f"{name}.npy": npy(array)}))
