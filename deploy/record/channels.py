"""The channels of a log, their fields, and a message's bytes. Nothing here needs a robot."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

NUMBER: dict[str, Any] = {"type": ["number", "null"]}
NUMBERS: dict[str, Any] = {"type": "array", "items": NUMBER}
INTEGER: dict[str, Any] = {"type": "integer"}
TEXT: dict[str, Any] = {"type": "string"}
TEXTS: dict[str, Any] = {"type": "array", "items": TEXT}
OBJECT: dict[str, Any] = {"type": "object"}
CHANNELS: dict[str, dict[str, Any]] = {
    "/state": {
        "joint_pos_rad": NUMBERS,
        "joint_vel_rad_s": NUMBERS,
        "joint_torque_nm": NUMBERS,
        "joint_age_s": NUMBERS,
        "imu_quat_wxyz": NUMBERS,
        "imu_ang_vel_b": NUMBERS,
        "imu_acc_b": NUMBERS,
        "imu_age_s": NUMBER,
        "temperature_c": NUMBERS,
        "charge": NUMBER,
        "supply": NUMBER,
        "supply_high": NUMBER,
        "true_root_pos_w": NUMBERS,
        "true_root_quat_wxyz": NUMBERS,
        "true_foot_contact": NUMBERS,
    },
    "/command": {"q_rad": NUMBERS, "kp": NUMBERS, "kd": NUMBERS},
    "/observation": {"groups": {"type": "object", "additionalProperties": NUMBERS}},
    "/action": {"policy_sha256": TEXT, "motion": TEXT, "tick": INTEGER, "action": NUMBERS, "target_rad": NUMBERS},
    "/condition": {"mode": TEXT, "trip": TEXT, "device_faults": TEXTS},
    "/remote": {"buttons": TEXTS, "age_s": NUMBER},
    "/events": {"event": TEXT, "detail": TEXT},
    "/timing": {"tick": INTEGER, "overruns": INTEGER, "phases_ms": OBJECT},
    "/wire": {"cycles": OBJECT, "stats": OBJECT},
    "/clock": {"unix_s": NUMBER},
}
Message = tuple[str, int, dict[str, Any]]
"""Channel, time of the loop's clock in ns, fields."""


def encoded(fields: Mapping[str, Any]) -> bytes:
    """JSON in which null stands for what is not a number."""
    return json.dumps(plain(fields), allow_nan=False).encode()


def plain(value: Any) -> Any:
    """What JSON can hold; float32 becomes the double of the same value."""
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray):
        numbers: Sequence[Any] = value.tolist()
        return numbers if np.isfinite(value).all() else [plain(number) for number in numbers]
    if isinstance(value, (list, tuple)):
        return [plain(inner) for inner in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
