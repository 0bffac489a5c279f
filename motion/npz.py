"""Reads .npz bytes from strangers: nothing executed, nothing allocated that the file does not really hold."""

import io
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np

from robot.errors import InputError

MAX_FILE_BYTES = 256 * 2**20
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_DAMAGE = (zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, struct.error)


def read_file(path: str | Path, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """Bytes of a regular file of at most `max_bytes`. Raises InputError naming the file."""
    path = Path(path)
    try:
        if not path.is_file():
            raise InputError("is no file" if path.exists() else "no such file", where=path, expected="a motion file")
        size = path.stat().st_size
        if size > max_bytes:
            raise InputError("file too large", where=path, got=f"{size} bytes", expected=f"at most {max_bytes}")
        return path.read_bytes()
    except OSError as error:
        raise InputError("cannot be read", where=path, got=error.strerror or error) from error


def read_npz(content: bytes, where: str) -> dict[str, np.ndarray]:
    """Every array (numbers or text) of an .npz by field name. Raises InputError naming `where` and the field."""
    if not content:
        raise InputError("empty file", where=where, expected="a motion clip (.npz)")
    arrays: dict[str, np.ndarray] = {}
    budget = MAX_FILE_BYTES
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for info in archive.infolist():
                name = info.filename.removesuffix(".npy")
                budget -= info.file_size
                _check_member(info, f"{where}: {name}", seen=name in arrays, budget=budget)
                with archive.open(info) as member:
                    arrays[name] = _read_npy(member.read(info.file_size), f"{where}: {name}")
    except InputError:
        raise
    except (*_DAMAGE, EOFError, OSError, RuntimeError, ValueError) as error:
        raise InputError("damaged or not an .npz", where=where, got=error, expected="a motion clip (.npz)") from error
    return arrays


def _check_member(info: zipfile.ZipInfo, where: str, *, seen: bool, budget: int) -> None:
    if seen:
        raise InputError("field appears twice", where=where)
    if info.compress_type not in _METHODS or info.flag_bits & 1:
        raise InputError("packed in an unknown way", where=where, expected="stored or deflated, not encrypted")
    if budget < 0:
        limit = f"at most {MAX_FILE_BYTES} bytes in all fields"
        raise InputError("too large unpacked", where=where, got=f"{info.file_size} bytes", expected=limit)


def _read_npy(content: bytes, where: str) -> np.ndarray:
    """One .npy member; the header's size is compared with the bytes before anything is allocated."""
    stream = io.BytesIO(content)
    expected = "a NumPy array (.npy 1.0 or 2.0)"
    try:
        if np.lib.format.read_magic(stream) == (1, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
        else:
            shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream)
    except Exception as error:  # NumPy's header parser raises many kinds; every one means the same to the user
        raise InputError("damaged array header", where=where, got=error, expected=expected) from error
    if dtype.hasobject or dtype.kind not in "fiuU" or not dtype.itemsize:
        raise InputError("type not allowed", where=where, got=f"type {dtype}", expected="numbers or text")
    count = 1
    for length in shape:
        count *= length
    data = content[stream.tell() :]
    if min(shape, default=0) < 0 or count * dtype.itemsize != len(data):
        got = f"shape {shape} of {dtype} in {len(data)} bytes"
        raise InputError("size does not fit its header", where=where, got=got, hint="the file may be truncated")
    if dtype.kind == "U" and not _is_text(np.frombuffer(data, dtype.str[0] + "u4")):
        raise InputError("damaged text", where=where)
    try:
        return np.frombuffer(data, dtype=dtype).reshape(shape, order="F" if fortran else "C")
    except (ValueError, OverflowError) as error:
        raise InputError("damaged array", where=where, got=error) from error


def _is_text(codes: np.ndarray) -> bool:
    """Whether all are Unicode characters: NumPy and Python crash on the conversion of others."""
    return bool(((codes < 0xD800) | ((codes > 0xDFFF) & (codes <= 0x10FFFF))).all())
