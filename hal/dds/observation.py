"""What is wrong with a robot, from what it said before anybody commanded it."""

from collections.abc import Iterable, Sequence

import numpy as np

from hal.dds.slots import DISCONNECTED, SLOT_NAMES, SLOTS, HeldMotor, machine_refusal
from hal.dds.state_reader import Counts

RANGE_MARGIN_RAD = 0.1
LEAST_RATE = 0.8
DRIVEN_HANDS = ("rt/dex3/", "rt/inspire/", "rt/brainco/")
SPOKEN = ("mode", "q", "dq", "tau_est", "vol", "motorstate")


def refusals(
    messages: Sequence[np.ndarray],
    counts: Counts,
    held: Sequence[HeldMotor],
    mode_machine: int,
    *,
    simulator: bool = False,
) -> list[str]:
    """Every reason not to command it, in words; empty where there is none. messages: LowStates in order of arrival.

    mode_machine: the machine that robot file and actors are for. simulator: a mode_machine or a tick that was never
    filled in is no reason.
    """
    if counts.bad_checksum:
        share = f"{counts.bad_checksum} of {counts.heard}"
        return [f"bad checksum in {share} LowStates"]
    if not messages:
        return [f"{counts.malformed} messages on rt/lowstate that are no LowState"]
    last = messages[-1]
    machine = int(last["mode_machine"])
    refused = None if simulator and machine == 0 else machine_refusal(machine, mode_machine)
    reasons = [] if refused is None else [refused]
    if int(last["mode_pr"]) != 0:
        reasons.append("mode_pr is not 0: ankles and waist are reported as parallel motors, restart the robot")
    reasons += [] if simulator and int(last["tick"]) == 0 else _ticks(messages)
    reasons += _motors(messages)
    reasons += _held_ranges(last, held)
    return reasons


def least_hz(state_hz: float) -> float:
    """How often a robot has to be heard that promises state_hz."""
    return LEAST_RATE * state_hz


def rate_refusal(rate_hz: float, state_hz: float) -> list[str]:
    """rate_hz: how often a new LowState came at best. One that is seen less often is controlled from older states."""
    if rate_hz >= least_hz(state_hz):
        return []
    return [f"new LowStates come at {rate_hz:.0f} Hz, {state_hz:g} Hz expected (state_hz): is the network slow?"]


def hand_refusal(topics: Iterable[str]) -> list[str]:
    """topics: what is published in the domain. Driven hands weigh more than the model's rubber ones."""
    found = sorted({topic for topic in topics if topic.startswith(DRIVEN_HANDS)})
    return [f"driven hands are there ({', '.join(found)}), the robot's model has rubber ones"] if found else []


def _ticks(messages: Sequence[np.ndarray]) -> list[str]:
    ticks = np.array([int(message["tick"]) for message in messages])
    if len(ticks) > 1 and (np.diff(ticks) < 0).any():
        return ["LowState's tick jumps back: is there a second robot in this domain?"]
    if len(ticks) > 1 and ticks[-1] == ticks[0]:
        return ["LowState's tick stands still"]
    return []


def _motors(messages: Sequence[np.ndarray]) -> list[str]:
    """A motor is missing where it is disconnected, or where everything that it ever says is zero."""
    states = np.stack([message["motor_state"][:SLOTS] for message in messages])
    disconnected = (states["motorstate"][-1] & DISCONNECTED) != 0
    speaks = np.any([(states[name] != 0).any(axis=0) for name in SPOKEN], axis=0)
    speaks |= (states["temperature"] != 0).any(axis=(0, 2))
    missing = disconnected | ~speaks
    names = [name for name, absent in zip(SLOT_NAMES, missing) if absent]
    return [f"missing motors: {', '.join(names)}"] if names else []


def _held_ranges(message: np.ndarray, held: Sequence[HeldMotor]) -> list[str]:
    """The robot's own joints are judged by whoever commands them."""
    reasons = []
    for joint in held:
        pos_rad = float(message["motor_state"]["q"][SLOT_NAMES.index(joint.name)])
        lower, upper = joint.range_rad[0] - RANGE_MARGIN_RAD, joint.range_rad[1] + RANGE_MARGIN_RAD
        if not lower <= pos_rad <= upper:
            reasons.append(f"{joint.name} at {pos_rad:.2f} rad, expected {joint.range_rad[0]} to {joint.range_rad[1]}")
    return reasons
