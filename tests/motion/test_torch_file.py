"""Torch files without torch: what comes back, and what never runs or costs memory."""

import io
import pickle
import tracemalloc
import zipfile
from collections import OrderedDict

import numpy as np
import pytest

from core.errors import InputError
from motion.importers.torch_file import read_torch
from tests.motion.human.smpl_files import torch_bytes

ARRAY = np.arange(12, dtype="<f4").reshape(3, 4)


def repacked(content: bytes, **members: bytes) -> bytes:
    """The archive with members (by the last part of their name) replaced."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(buffer, "w") as new:
        for name in old.namelist():
            new.writestr(name, members.get(name.rpartition("/")[2], old.read(name)))
    return buffer.getvalue()


def pickled(content: bytes) -> bytes:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return archive.read("x/data.pkl")


def test_dicts_of_tensors():
    got = read_torch(torch_bytes({"a": {"b": ARRAY, "c": ARRAY[0]}, "n": None, "t": "text", "l": [1, 2.5]}), "x.pt")
    np.testing.assert_array_equal(got["a"]["b"], ARRAY)
    np.testing.assert_array_equal(got["a"]["c"], ARRAY[0])
    assert got["a"]["b"].dtype == np.float32 and not got["a"]["b"].flags.writeable
    assert (got["n"], got["t"], got["l"]) == (None, "text", [1, 2.5])


def test_what_torch_writes():
    torch = pytest.importorskip("torch")
    table = {
        "float": torch.randn(5, 63, generator=torch.Generator().manual_seed(0)),
        "double": torch.arange(3.0).double(),
        "transposed": torch.arange(12).reshape(3, 4).T,
        "part": torch.arange(12).reshape(3, 4)[1:, ::2],
        "empty": torch.zeros(0, 3),
        "repeated": torch.ones(1).expand(5, 3),
        "half": torch.ones(2).half(),
        "flags": torch.tensor([True, False]),
        "scalar": torch.tensor(3.0),
        "parameter": torch.nn.Parameter(torch.ones(3)),
    }
    buffer = io.BytesIO()
    torch.save(OrderedDict(table), buffer)
    got = read_torch(buffer.getvalue(), "x.pt")
    assert got.keys() == table.keys()
    for name, tensor in table.items():
        np.testing.assert_array_equal(got[name], tensor.detach().numpy())
        assert got[name].dtype == tensor.detach().numpy().dtype


class Evil:
    def __reduce__(self):
        return (open, ("executed", "w"))


def test_nothing_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    content = torch_bytes({"a": ARRAY}, "x")
    for evil in (pickle.dumps(Evil(), 2), pickle.dumps({"a": [Evil()]}, 4), b"ctorch\nload\n(X\x01\x00\x00\x00xtR."):
        with pytest.raises(InputError, match=r"x\.pt: data\.pkl: refused pickle, got global"):
            read_torch(repacked(content, **{"data.pkl": evil}), "x.pt")
    assert not (tmp_path / "executed").exists()


CHANGES = {
    "no storage": ((b"X\x01\x00\x00\x000", b"X\x01\x00\x00\x007"), "storage 7 is missing or cut short"),
    "longer storage": ((b"K\x0ctq", b"K\x0dtq"), "storage 0 is missing or cut short"),
    "unknown storage": ((b"FloatStorage", b"FoolsStorage"), "refused pickle, got global 'torch.FoolsStorage'"),
    "beyond its storage": ((b"K\x00K\x03K\x04\x86", b"K\x01K\x03K\x04\x86"), "beyond its storage of 12"),
    "huge": ((b"K\x00K\x03K\x04\x86", b"K\x00J\xff\xff\xff\x7fK\x04\x86"), "beyond its storage of 12"),
    "negative offset": ((b"K\x00K\x03K\x04\x86", b"J\xff\xff\xff\xffK\x03K\x04\x86"), "beyond its storage of 12"),
    "negative size": ((b"K\x00K\x03K\x04\x86", b"K\x00J\xff\xff\xff\xffK\x04\x86"), "array without a shape"),
    "one size": ((b"K\x03K\x04\x86", b"K\x03\x85"), "tensor without a shape"),
}


@pytest.mark.parametrize(("change", "message"), CHANGES.values(), ids=CHANGES)
def test_lying_tensors(change, message):
    content = torch_bytes({"a": ARRAY}, "x")
    program = pickled(content)
    assert change[0] in program
    with pytest.raises(InputError, match=rf"^x\.pt: data\.pkl: .*{message}"):
        read_torch(repacked(content, **{"data.pkl": program.replace(*change)}), "x.pt")


def test_repeated_values_cost_nothing():
    """Strides of zero: a tensor of 10^18 entries that stands on one."""
    content = torch_bytes({"a": ARRAY}, "x")
    program = pickled(content).replace(b"K\x03K\x04\x86", b"\x8a\x05\x00\x00\x00\x00\x01\x8a\x04\x00\x00\x00\x40\x86")
    program = program.replace(b"K\x04K\x01\x86", b"K\x00K\x00\x86")
    tracemalloc.start()
    try:
        assert read_torch(repacked(content, **{"data.pkl": program}), "x.pt")["a"].shape == (2**32, 2**30)
    except InputError as error:
        assert "data.pkl" in str(error)
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()


def test_archives_that_are_none():
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("x/readme", "text")
    with pytest.raises(InputError, match=r"x\.pt: not a torch file, got no data\.pkl"):
        read_torch(buffer.getvalue(), "x.pt")
    content = torch_bytes({"a": ARRAY}, "x")
    for length in range(0, len(content), 13):
        with pytest.raises(InputError, match=r"^x\.pt: damaged archive"):
            read_torch(content[:length], "x.pt")


def test_damaged_files_are_one_error():
    content = torch_bytes({"smpl_params_global": {"a": ARRAY, "b": ARRAY[1]}}, "x")
    program = pickled(content)
    rng = np.random.default_rng(0)
    for _ in range(600):
        damaged = bytearray(program)
        for position in rng.integers(0, len(program), 2):
            damaged[position] = int(rng.integers(256))
        try:
            read_torch(repacked(content, **{"data.pkl": bytes(damaged)}), "x.pt")
        except InputError as error:
            assert "\n" not in str(error)
