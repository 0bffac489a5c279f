"""Pickles from strangers: data is read, anything else is refused by name and never run."""

import io
import os
import pickle
import pickletools
import subprocess
import sys

import numpy as np
import pytest

from core.errors import InputError
from motion.importers.pickle_data import ALLOWED_GLOBALS, read_data_pickle


@pytest.fixture
def marker(tmp_path, monkeypatch):
    """The file that every attack below leaves in the working folder when it is executed."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "executed"
    yield path
    assert not path.exists(), "the pickle was executed"


class Calls:
    """Pickles as a call of `function` with `arguments`."""

    def __init__(self, function, *arguments, state=None):
        self.result = (function, arguments) if state is None else (function, arguments, state)

    def __reduce__(self):
        return self.result


ATTACKS = {
    "os.system": (os.system, "touch executed"),
    "builtins.eval": (eval, "__import__('os').system('touch executed')"),
    "builtins.exec": (exec, "open('executed', 'w')"),
    "builtins.getattr": (getattr, "", "upper"),
    "builtins.open": (open, "executed", "w"),
    "builtins.__import__": (__import__, "os"),
    "subprocess.Popen": (subprocess.Popen, "touch executed"),
    "numpy.load": (np.load, "evil.npy"),
    "numpy.fromfile": (np.fromfile, "/etc/passwd"),
    "numpy.memmap": (np.memmap, "executed"),
    "numpy.array": (np.array, [1.0]),
    "_io.FileIO": (io.FileIO, "executed", "w"),
}


ATTACK_PICKLES = {
    f"{name} protocol {protocol}": (name.rpartition(".")[2], pickle.dumps({"motion": {"dof": Calls(*call)}}, protocol))
    for name, call in ATTACKS.items()
    for protocol in range(6)
}
OBJECT_ARRAY = pickle.dumps({"dof": np.array([Calls(os.system, "touch executed")], dtype=object)}, 4)
CALLING_STATE = pickle.dumps(Calls(np.dtype, "f8", state={"x": Calls(os.system, "touch executed")}), 4)


@pytest.mark.parametrize(("expected", "content"), ATTACK_PICKLES.values(), ids=ATTACK_PICKLES)
def test_a_call_of_anything_else_is_refused_and_named(marker, expected, content):
    with pytest.raises(InputError, match=rf"evil\.pkl: refused pickle, got global '[\w.]*\.?{expected}'"):
        read_data_pickle(content, "evil.pkl")


HAND_MADE = {
    "INST": b"(S'touch executed'\nios\nsystem\n.",
    "OBJ": b"(cos\nsystem\nS'touch executed'\no.",
    "GLOBAL": b"cos\nsystem\n(S'touch executed'\ntR.",
    "dotted name": b"\x80\x04\x8c\x05numpy\x8c\x14testing.os.system_xx\x93.",
    "dotted through an allowed name": b"\x80\x04\x8c\x05numpy\x8c\x0fndarray.__new__\x93.",
    "extension registry": b"\x80\x02\x82\x01.",
    "persistent id": b"Pevil\n.",
    "binary persistent id": b"\x80\x02K\x01Q.",
    "call of an allowed type name": b"\x80\x02cnumpy\nndarray\n(K\x02tR.",
    "call of a text": b"\x80\x02X\x09\x00\x00\x00os.system(tR.",
    "call of a number": b"\x80\x02K\x01(tR.",
    "state on an allowed name": b"\x80\x02cnumpy\nndarray\n}b.",
    "state on a dict": b"\x80\x02}}b.",
    "attributes on an allowed name": b"\x80\x02cnumpy\ndtype\nN}X\x01\x00\x00\x00aK\x01s\x86b.",
    "construct a number": b"\x80\x02K\x01)\x81.",
    "append to a name": b"\x80\x02cnumpy\nndarray\nK\x01a.",
    "items of a name": b"\x80\x02cnumpy\nndarray\nK\x01K\x02s.",
    "keys that hash forever": b"\x80\x02})\x86K\x01s.",
    "set": b"\x80\x04\x8f.",
}


@pytest.mark.parametrize("content", HAND_MADE.values(), ids=HAND_MADE)
def test_hand_made_programs_are_refused(marker, content):
    with pytest.raises(InputError, match=r"evil\.pkl: (refused|damaged) pickle"):
        read_data_pickle(content, "evil.pkl")


def test_the_attacks_would_work(tmp_path, monkeypatch):
    """Python's own unpickler does run them."""
    monkeypatch.chdir(tmp_path)
    for name in ("os.system", "builtins.eval", "builtins.exec", "builtins.open"):
        pickle.loads(ATTACK_PICKLES[f"{name} protocol 4"][1])
        (tmp_path / "executed").unlink()


def test_an_array_of_objects_is_refused(marker):
    with pytest.raises(InputError, match="refused pickle"):
        read_data_pickle(OBJECT_ARRAY, "evil.pkl")
    content = pickle.dumps({"dof": np.array([None, 1], dtype=object)}, 4)
    with pytest.raises(InputError, match="array that does not hold numbers"):
        read_data_pickle(content, "evil.pkl")


def test_state_that_calls_is_refused(marker):
    """A harmless constructor with a harmful state."""
    with pytest.raises(InputError, match=r"refused pickle, got global '\w+\.system'"):
        read_data_pickle(CALLING_STATE, "evil.pkl")


def test_nothing_is_imported(marker):
    """Even the module of a refused global stays out."""
    sys.modules.pop("antigravity", None)
    with pytest.raises(InputError, match=r"global 'antigravity\.x'"):
        read_data_pickle(b"\x80\x02cantigravity\nx\n.", "evil.pkl")
    assert "antigravity" not in sys.modules


def test_the_allow_list_is_short():
    modules = {name.rpartition(".")[0] for name in ALLOWED_GLOBALS}
    assert {m.partition(".")[0] for m in modules} == {"numpy", "joblib"}
    assert len(ALLOWED_GLOBALS) == 9


DATA = {
    "plain": {"a": [1, -2, 3.5, None, True, False, 2**70, "é", b"x"], "b": (1, (2, 3), ()), "c": {1: {"d": []}}},
    "long list": list(range(3000)),
    "nested": [[["x"] * 3] * 2],
}


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
@pytest.mark.parametrize("value", DATA.values(), ids=DATA)
def test_plain_data_comes_back(value, protocol):
    if protocol == 2 and "a" in value:
        value = {**value, "a": value["a"][:-1]}  # protocol 2 writes bytes as a call
    assert read_data_pickle(pickle.dumps(value, protocol), "x") == value
    assert read_data_pickle(pickletools.optimize(pickle.dumps(value, protocol)), "x") == value


@pytest.mark.parametrize("protocol", [3, 4, 5])
@pytest.mark.parametrize("dtype", ["<f4", "<f8", ">f8", "<i8", "u1", "?", "<i2"])
def test_numpy_arrays_come_back(protocol, dtype):
    for array in (np.arange(12).reshape(3, 4), np.zeros((0, 3)), np.array(3), np.asfortranarray(np.ones((2, 5)))):
        array = array.astype(dtype)
        got = read_data_pickle(pickle.dumps({"x": array, "again": array}, protocol), "x")
        np.testing.assert_array_equal(got["x"], array)
        np.testing.assert_array_equal(got["again"], array)
        assert got["x"].dtype == array.dtype


def test_numpy_scalars_come_back():
    got = read_data_pickle(pickle.dumps({"fps": np.float32(30.0), "n": np.int64(-3)}, 4), "x")
    assert got == {"fps": 30.0, "n": -3}


def test_truncations_and_flips_are_one_error(marker):
    content = pickle.dumps({"k": {"dof": np.arange(6.0).reshape(2, 3), "fps": 30, "t": "text"}}, 4)
    for length in range(len(content)):
        with pytest.raises(InputError):
            read_data_pickle(content[:length], "cut.pkl")
    rng = np.random.default_rng(0)
    for _ in range(3000):
        damaged = bytearray(content)
        for position in rng.integers(0, len(content), 2):
            damaged[position] = int(rng.integers(256))
        try:
            read_data_pickle(bytes(damaged), "flip.pkl")
        except InputError as error:
            assert "\n" not in str(error)


@pytest.mark.parametrize("shape", [b"\x8a\x10" + b"\xff" * 15 + b"\x7f", b"\x8a\x06\x00\x00\x00\x00\x00\x01"])
def test_shapes_beyond_the_file_allocate_nothing(shape):
    head = b"\x80\x04\x8c\x05numpy\x8c\x05dtype\x93\x8c\x02f8\x85R\x94"
    frame = b"\x8c\x13joblib.numpy_pickle\x8c\x11NumpyArrayWrapper\x93)\x81}("
    state = b"\x8c\x05shape" + shape + b"\x85\x8c\x05order\x8c\x01C\x8c\x05dtypeh\x00ub."
    with pytest.raises(InputError):
        read_data_pickle(head + frame + state + bytes(64), "huge.pkl")


def test_endless_programs_end():
    with pytest.raises(InputError, match="opcodes"):
        read_data_pickle(b"\x80\x04" + b"]" * 1_100_000 + b".", "long.pkl")
