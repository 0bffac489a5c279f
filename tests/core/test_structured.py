"""Plain data into dataclasses: what is read, and the exact words about what is not."""

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import pytest

from core.errors import InputError
from core.structured import (
    at_least,
    check_keys,
    distinct,
    none_negative,
    one_of,
    ordered,
    parse,
    pick,
    positive,
    within,
)


@dataclass(frozen=True)
class Motor:
    joint: str
    speed_rad_s: float
    range_rad: tuple[float, float] = (-1.0, 1.0)
    teeth: int = 12

    def __post_init__(self) -> None:
        positive("speed_rad_s", self.speed_rad_s)
        within("teeth", self.teeth, 8, 100)


@dataclass(frozen=True)
class Bus:
    motors: tuple[Motor, ...]
    kind: Literal["can", "rs485"] = "can"


@dataclass(frozen=True, eq=False)
class Machine:
    name: str
    bus: Bus
    gains: np.ndarray
    spare: Motor | None = None
    torque_nm: dict[str, float] = field(default_factory=dict)
    flat: bool = False
    extra: dict[str, Any] = field(default_factory=dict)
    options: dict = field(default_factory=dict)


KNEE = {"joint": "knee", "speed_rad_s": 20}
GOOD = {"name": "toy", "bus": {"motors": [{"joint": "hip", "speed_rad_s": 32.5}, KNEE]}, "gains": [1, 2.5]}


def changed(path: str, value: object) -> dict:
    """GOOD with one entry set, or taken away where the value is None."""

    def walk(node: Any, keys: list[str]) -> Any:
        if not keys:
            return value
        if isinstance(node, list):
            return [walk(part, keys[1:]) if str(i) == keys[0] else part for i, part in enumerate(node)]
        rest = {key: part for key, part in node.items() if key != keys[0]}
        return rest if value is None and len(keys) == 1 else rest | {keys[0]: walk(node.get(keys[0], {}), keys[1:])}

    return walk(GOOD, path.split("."))


def test_every_kind_of_field_is_read():
    machine = parse(
        Machine, GOOD | {"spare": KNEE, "torque_nm": {"hip": 5}, "flat": True, "extra": {"a": [1, "b"]}, "options": {}}
    )
    assert machine.bus == Bus((Motor("hip", 32.5), Motor("knee", 20.0)))
    assert type(machine.bus.motors[1].speed_rad_s) is float and type(machine.bus.motors[1].teeth) is int
    assert machine.spare == Motor("knee", 20.0, (-1.0, 1.0), 12)
    assert machine.torque_nm == {"hip": 5.0} and machine.flat is True and machine.extra == {"a": [1, "b"]}
    assert machine.gains.dtype == np.float64 and machine.gains.tolist() == [1.0, 2.5]
    with pytest.raises(ValueError, match="read-only"):
        machine.gains[0] = 3.0
    assert parse(Machine, GOOD | {"spare": None}).spare is None


REFUSED = [
    ("nmae", 1, "nmae: unknown key, expected one of name, bus, gains, spare, torque_nm, flat, extra, options; "
     "did you mean name?"),
    ("bus", None, "bus: missing key, got name, gains"),
    ("bus", {}, "bus.motors: missing key, got nothing"),
    ("bus", [], "bus: wrong type, got [], expected a mapping"),
    ("bus.kind", "usb", "bus.kind: unknown choice, got usb, expected one of can, rs485"),
    ("bus.kind", "rs458", "bus.kind: unknown choice, got rs458, expected one of can, rs485; did you mean rs485?"),
    ("bus.motors", 3, "bus.motors: wrong type, got 3, expected a list"),
    ("bus.motors.1", {}, "bus.motors[1]: missing keys joint, speed_rad_s, got nothing"),
    ("bus.motors.1.speed_rad_s", "fast",
     "bus.motors[1 knee].speed_rad_s: wrong type, got 'fast', expected a number in rad/s"),
    ("bus.motors.1.speed_rad_s", True,
     "bus.motors[1 knee].speed_rad_s: wrong type, got True, expected a number in rad/s"),
    ("bus.motors.1.speed_rad_s", math.inf, "bus.motors[1 knee].speed_rad_s: not finite, got inf, "
     "expected a finite number"),
    ("bus.motors.1.speed_rad_s", 0,
     "bus.motors[1 knee].speed_rad_s: not positive, got 0.0, expected a number above 0 rad/s"),
    ("bus.motors.1.range_rad", [1], "bus.motors[1 knee].range_rad: wrong length, got [1], "
     "expected a list of 2 numbers"),
    ("bus.motors.1.range_rad", [1, "b"], "bus.motors[1 knee].range_rad[1]: wrong type, got 'b', "
     "expected a number in rad"),
    ("bus.motors.1.teeth", 12.0, "bus.motors[1 knee].teeth: wrong type, got 12.0, expected a whole number"),
    ("bus.motors.1.teeth", 7, "bus.motors[1 knee].teeth: out of range, got 7, expected a number in [8, 100]"),
    ("spare", {"joint": "neck", "speed_rad_s": -1},
     "spare.speed_rad_s: not positive, got -1.0, expected a number above 0 rad/s"),
    ("gains", 3, "gains: wrong type, got 3, expected a list"),
    ("gains", [1, None], "gains[1]: wrong type, got None, expected a number"),
    ("gains", [10**400], f"gains[0]: not finite, got {10**400}, expected a finite number"),
    ("torque_nm", {"hip": "5"}, "torque_nm.hip: wrong type, got '5', expected a number"),
    ("torque_nm", {7: 5}, "torque_nm.7: wrong type, got 7, expected text; put it in quotes"),
    ("name", 23, "name: wrong type, got 23, expected text; put it in quotes"),
    ("flat", 1, "flat: wrong type, got 1, expected true or false"),
    ("options", 5, "options: wrong type, got 5, expected a mapping"),
]  # fmt: skip


@pytest.mark.parametrize(("path", "value", "text"), REFUSED)
def test_what_does_not_fit_is_named_by_its_full_path(path, value, text):
    with pytest.raises(InputError) as caught:
        parse(Machine, changed(path, value))
    assert str(caught.value) == text


def test_a_path_begins_where_the_caller_says():
    with pytest.raises(InputError) as caught:
        parse(Machine, changed("bus.motors.0.teeth", 200), "machine")
    assert str(caught.value) == "machine.bus.motors[0 hip].teeth: out of range, got 200, expected a number in [8, 100]"
    with pytest.raises(InputError, match=r"^configuration: wrong type, got 3, expected a mapping$"):
        parse(Machine, 3)


def test_a_section_that_names_itself_is_named_once():
    @dataclass(frozen=True)
    class Learner:
        clip: float

        def __post_init__(self) -> None:
            positive("learner.clip", self.clip)

    with pytest.raises(InputError, match=r"^learner\.clip: not positive"):
        parse(dict[str, Learner], {"learner": {"clip": 0}})
    with pytest.raises(InputError, match=r"^learn\.learner\.clip: not positive"):
        parse(dict[str, Learner], {"learn": {"clip": 0}})


def test_one_entry_of_a_document_that_holds_other_things():
    document = {"robot": {"names": ["hip"], "rest": "${x}"}, 3: 4}
    assert pick(tuple[str, ...], document, "robot.names") == ("hip",)
    for path, text in {
        "robt.names": "robt: missing key, got robot, 3; did you mean robot?",
        "robot.kp.hip": "robot.kp: missing key, got names, rest",
        "robot.rest.deep": "robot.rest: wrong type, got '${x}', expected a mapping",
    }.items():
        with pytest.raises(InputError) as caught:
            pick(float, document, path)
        assert str(caught.value) == text


@pytest.mark.parametrize(
    ("check", "arguments", "text"),
    [
        (at_least, (0.5, 1.0), "too small, got 0.5, expected at least 1.0 Nm"),
        (at_least, (math.inf, 1.0), "not finite, got inf, expected at least 1.0 Nm"),
        (at_least, (math.nan, 1.0), "not finite, got nan, expected at least 1.0 Nm"),
        (positive, (0,), "not positive, got 0, expected a number above 0 Nm"),
        (within, (2, 0, 1), "out of range, got 2, expected a number in [0, 1] Nm"),
        (ordered, ((2.0, 1.0),), "not a range, got [2.0, 1.0], expected [from, to] in Nm with 0 ≤ from ≤ to"),
        (ordered, ((0.0, math.inf),), "not a range, got [0.0, inf], expected [from, to] in Nm with 0 ≤ from ≤ to"),
        (one_of, ("neck", ("hip", "knee")), "unknown choice, got neck, expected one of hip, knee"),
        (distinct, (["hip", "knee", "hip"],), "given twice, got hip, expected each once"),
    ],
)
def test_bounds_say_place_value_and_unit(check, arguments, text):
    with pytest.raises(InputError) as caught:
        check("limits.torque_nm", *arguments)
    assert str(caught.value) == f"limits.torque_nm: {text}"


def test_bounds_themselves_are_allowed():
    at_least("a", 1, 1)
    within("a", 0.0, 0.0, 1.0)
    within("a", 1.0, 0.0, 1.0)
    ordered("a", (0.0, 0.0))
    one_of("a", "hip", ("hip",))
    distinct("a", [])
    check_keys({"a": 1}, ("a", "b"), "", optional=("b",))


def test_no_number_of_a_section_is_negative():
    none_negative(Motor("hip", 1.0, (-2.0, -1.0)))
    with pytest.raises(InputError, match=r"^motor\.cold_c: too small, got -1, expected at least 0 °C$"):
        none_negative(dataclass(type("Cold", (), {"__annotations__": {"cold_c": float}, "cold_c": -1}))(), "motor")
