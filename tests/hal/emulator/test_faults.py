import math
import re
from pathlib import Path

import numpy as np
import pytest

from core.errors import InputError
from hal.emulator.faults import COMMON_KINDS, UNHARMED, DelayLine, EmulatedFault, Faults, parse_fault
from tests.hal.emulator.rig import FakeTime


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("silence", EmulatedFault("silence")),
        ("silence:left_knee_joint@5+0.5", EmulatedFault("silence", "left_knee_joint", None, 5.0, 0.5)),
        ("delay=0.04", EmulatedFault("delay", "*", 0.04)),
        ("fault_code:bus0=-3@2", EmulatedFault("fault_code", "bus0", -3.0, 2.0)),
    ],
)
def test_a_fault_is_read_from_text(text, expected):
    assert parse_fault(text) == expected


@pytest.mark.parametrize("text", ["delay=soon", "silence@-1", "silence@1+0", "delay=nan", "silence@inf", "delay=1@x+2"])
def test_text_that_is_no_fault_is_refused(text):
    with pytest.raises(InputError):
        parse_fault(text)


def test_unknown_kinds_and_keys_and_needless_values_are_refused():
    with pytest.raises(InputError, match="unknown fault"):
        Faults([EmulatedFault("hiccup")])
    with pytest.raises(InputError, match="takes no value"):
        Faults([EmulatedFault("silence", value=1.0)])
    faults = Faults([EmulatedFault("silence", "left_toe_joint")])
    with pytest.raises(InputError, match="left_toe_joint"):
        faults.begin(["left_knee_joint"])


def test_a_fault_strikes_in_its_time_and_only_its_key():
    time = FakeTime()
    faults = Faults([EmulatedFault("silence", "knee", start_s=1.0, duration_s=0.5)], now=time)
    time.now_s += 30.0
    faults.begin(["knee", "hip", "bus0"])
    struck = []
    for t_s in (0.99, 1.0, 1.49, 1.5):
        time.now_s = 130.0 + t_s
        struck.append((faults.fate("knee", "bus0").lost, faults.fate("hip", "bus0").lost))
    assert struck == [(False, False), (True, False), (True, False), (False, False)]
    assert faults.fate("knee") is UNHARMED


def test_a_key_may_be_any_of_the_names_a_frame_goes_by_and_a_star_is_everything():
    faults = Faults([EmulatedFault("delay", "bus0", 0.04)])
    assert faults.fate("knee", "bus0").delay_s == 0.04
    assert faults.fate("knee", "bus1").delay_s == 0.0
    faults.add("over_temperature")
    assert faults.value("over_temperature", "hip") == COMMON_KINDS["over_temperature"].default
    assert faults.value("fault_code", "hip") is None


def test_faults_on_request_end_by_themselves_or_when_cleared():
    time = FakeTime()
    faults = Faults(now=time)
    faults.begin(["knee"])
    time.now_s += 7.0
    faults.add("deaf", "knee", duration_s=0.1)
    assert not faults.hears("knee") and faults.powered("knee")
    time.now_s += 0.11
    assert faults.hears("knee")
    faults.add("brown_out")
    faults.add("delay", "knee", value=0.5)
    assert not faults.hears("knee") and not faults.powered("knee") and faults.fate("knee").lost
    assert faults.clear("delay", "hip") == 0
    assert faults.clear("brown_out") == 1
    assert faults.fate("knee") == (False, 0.5, False, False)
    assert [fault["active"] for fault in faults.listing()] == [False, True]
    assert faults.clear() == 2 and faults.fate("knee") is UNHARMED


def test_the_document_lists_every_kind_with_its_default():
    text = (Path(__file__).parents[3] / "docs" / "hal_emulators.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \|.*\|([^|]*)\|$", text, flags=re.MULTILINE)
    numbers = {"": None, "2π": 2 * math.pi}
    listed = {kind: numbers[d] if (d := default.strip()) in numbers else float(d) for kind, default in rows}
    assert listed == {name: kind.default for name, kind in COMMON_KINDS.items()}


def test_chances_are_kept():
    faults = Faults([EmulatedFault("drop", value=0.25), EmulatedFault("jitter", value=0.01)], seed=1)
    fates = [faults.fate("knee") for _ in range(4000)]
    assert np.mean([fate.lost for fate in fates]) == pytest.approx(0.25, abs=0.03)
    delays = [fate.delay_s for fate in fates]
    assert max(delays) <= 0.01 and np.mean(delays) == pytest.approx(0.005, abs=0.0005)


def test_corruption_always_changes_one_to_three_bits():
    faults = Faults(seed=2)
    data = bytes(range(8))
    for _ in range(200):
        changed = faults.corrupted(data)
        flipped = sum((a ^ b).bit_count() for a, b in zip(data, changed, strict=True))
        assert 1 <= flipped <= 3
    assert faults.corrupted(b"") == b""


def test_a_delay_line_keeps_the_order_of_sending():
    line = DelayLine()
    assert line.due_s == math.inf
    line.put(2.0, "a")
    line.put(1.0, "b")
    line.put(3.0, "c")
    assert line.arrived(1.9) == []
    assert line.arrived(2.0) == ["a", "b"]
    assert line.due_s == 3.0
