"""Reads .npz (and other zip) bytes from strangers: nothing executed, nothing allocated that they do not really hold."""

import io
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from core.errors import InputError

MAX_FILE_BYTES = 256 * 2**20
MAX_TEXT = 200  # characters of what another library says
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_DAMAGE = (zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, struct.error)


def read_file(path: str | Path) -> bytes:
    """Bytes of a regular file of at most MAX_FILE_BYTES. Raises InputError naming the file."""
    path = Path(path)
    try:
        if not path.is_file():
            raise InputError("is no file" if path.exists() else "no such file", where=path, expected="a motion file")
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise InputError("file too large", where=path, got=f"{size} bytes", expected=f"at most {MAX_FILE_BYTES}")
        return path.read_bytes()
    except OSError as error:
        raise InputError("cannot be read", where=path, got=error.strerror or error) from error


def read_npz(content: bytes, where: str, only: frozenset[str] | None = None) -> dict[str, np.ndarray]:
    """Every array (numbers or text) of an .npz by field name, or `only` those fields; others are not even unpacked.

    Raises InputError naming `where` and the field.
    """
    if not content:
        raise InputError("empty file", where=where, expected="a motion clip (.npz)")
    wanted = (lambda _: True) if only is None else (lambda name: name.removesuffix(".npy") in only)
    return {
        name.removesuffix(".npy"): _read_npy(member, f"{where}: {name.removesuffix('.npy')}")
        for name, member in zip_members(content, where, wanted)
    }


def zip_names(content: bytes, where: str) -> list[str]:
    """Names of the members of a zip archive. Raises InputError naming `where`."""
    return [name for name, _ in _opened(content, where, lambda _: False)]


def zip_members(content: bytes, where: str, wanted: Callable[[str], bool]) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of the members that are `wanted`, at most MAX_FILE_BYTES in all, each name once.

    Raises InputError naming `where` and the member before anything too large is unpacked.
    """
    return ((name, member) for name, member in _opened(content, where, wanted) if member is not None)


def _opened(content: bytes, where: str, wanted: Callable[[str], bool]) -> Iterator[tuple[str, bytes | None]]:
    """Every member's name, with its bytes where it is wanted."""
    seen: set[str] = set()
    budget = MAX_FILE_BYTES
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for info in archive.infolist():
                if not wanted(info.filename):
                    yield info.filename, None
                    continue
                budget -= info.file_size
                name = info.filename.removesuffix(".npy")
                _check_member(info, f"{where}: {name}", seen=name in seen, budget=budget)
                seen.add(name)
                with archive.open(info) as member:
                    yield info.filename, member.read(info.file_size)
    except InputError:
        raise
    except (*_DAMAGE, EOFError, OSError, RuntimeError, ValueError) as error:
        raise InputError(
            "damaged archive", where=where, got=str(error)[:MAX_TEXT], expected="a complete .npz or .pt file"
        ) from error


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
        raise InputError("damaged array header", where=where, got=str(error)[:MAX_TEXT], expected=expected) from error
    if dtype.hasobject or dtype.kind not in "fiuUS" or not dtype.itemsize:
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
        raise InputError("damaged array", where=where, got=str(error)[:MAX_TEXT]) from error


def _is_text(codes: np.ndarray) -> bool:
    """Whether all are Unicode characters: NumPy and Python crash on the conversion of others."""
    return bool(((codes < 0xD800) | ((codes > 0xDFFF) & (codes <= 0x10FFFF))).all())
