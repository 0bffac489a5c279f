"""What is checked before anything is energised."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.clock import Clock
from core.rotations import projected_gravity
from deploy.actor_run import ActorRun
from deploy.safety.battery import excess, shortage
from deploy.settings import PreflightSettings
from hal.contract.backend import Backend
from hal.contract.types import DeviceError, DeviceInfo, LinkLost, NoState, RobotState
from robot.robot import Robot

GRAVITY_M_S2 = 9.81
GAIN_ROUNDING = 1e-3
# A link may be lost for so long while nothing is energised yet: a computer that starts is busy.
GAP_S = 0.5


@dataclass(frozen=True)
class Check:
    """One row of the table. remarkable: passed, but a person should read what was found."""

    what: str
    passed: bool
    found: str
    remarkable: bool = False

    @property
    def mark(self) -> str:
        """`ok`, `note` or `NO`."""
        return "NO" if not self.passed else "note" if self.remarkable else "ok"


class PreflightRefused(DeviceError):
    """The device is not fit to be energised."""


def run_preflight(
    backend: Backend,
    info: DeviceInfo,
    clock: Clock,
    robot: Robot,
    actors: Sequence[ActorRun],
    settings: PreflightSettings,
    *,
    at_rest: bool,
) -> list[Check]:
    """Read states and judge them. at_rest: whether the robot is supported and still, so that gravity can be judged."""
    settle, keep = (round(settings.settle_s / backend.control_period_s), settings.samples) if at_rest else (0, 1)
    states, gaps_s = _read_states(backend, clock, settings.state_wait_s, settle, keep)
    checks = [_check_names(info, robot), *(_check_actor(actor, robot, info) for actor in actors), _link_line(gaps_s)]
    limit_s = settings.age_periods * backend.control_period_s
    checks += [_check_age(states, limit_s), _check_faults(states), _check_finite(states)]
    checks += [_check_temperature(states, robot, settings), _check_battery(states, settings)]
    checks += [_check_range(states, robot, settings), *_boxes_line(actors)]
    if at_rest:
        checks += [_check_upright(states, settings)]
        checks += [_check_gravity(states, settings), _check_acceleration(states, settings)]
    details = [Check(name, True, value) for name, value in info.details.items()]
    return [*checks, Check("device watchdog", True, info.watchdog or "none: only this computer can damp"), *details]


def table(checks: Sequence[Check]) -> str:
    """The checks as lines of text."""
    marks, width = max(len(check.mark) for check in checks), max(len(check.what) for check in checks)
    return "\n".join(f"  {check.mark:{marks}}  {check.what:{width}}  {check.found}" for check in checks)


def require(checks: Sequence[Check], what: str = "preflight") -> None:
    """Raise Refused, naming what failed."""
    failed = [f"{check.what}: {check.found}" for check in checks if not check.passed]
    if failed:
        raise PreflightRefused(f"{what} refused: {'; '.join(failed)}")


def _read_states(
    backend: Backend, clock: Clock, wait_s: float, settle: int, keep: int
) -> tuple[list[RobotState], list[float]]:
    """One state per control period: waits for the first, lets the robot settle, keeps the rest. Raises DeviceError.

    A link that is lost for less than 0.5 s begins the settling anew; second, how long it was lost each time (s).
    """
    start_s = heard_s = clock.now_s()
    states: list[RobotState] = []
    gaps_s: list[float] = []
    lost = False
    for tick in itertools.count(1):
        now_s = clock.now_s()
        try:
            states.append(backend.read())
            if lost:
                gaps_s.append(now_s - heard_s)
            heard_s, lost = now_s, False
        except (NoState, LinkLost) as error:
            lost = isinstance(error, LinkLost)
            if now_s - start_s > wait_s or (lost and now_s - heard_s > GAP_S):
                raise
            states.clear()
        if len(states) >= settle + max(1, keep):
            break
        clock.sleep_until(start_s + tick * backend.control_period_s)
    return states[settle:], gaps_s


def _link_line(gaps_s: Sequence[float]) -> Check:
    if not gaps_s:
        return Check("link", True, "steady")
    return Check("link", True, f"lost {len(gaps_s)}x, for {1e3 * max(gaps_s):.0f} ms at most, then steady")


def _check_names(info: DeviceInfo, robot: Robot) -> Check:
    differing = sorted(set(info.joint_names) ^ set(robot.joint_names))
    same = info.joint_names == robot.joint_names
    found = f"{len(info.joint_names)} on {info.name}" if same else f"differ: {', '.join(differing) or 'order'}"
    return Check("joint names", same, found)


def _check_actor(actor: ActorRun, robot: Robot, info: DeviceInfo) -> Check:
    spec = actor.actor.spec
    gains = {name: (kp, kd) for name, kp, kd in zip(spec.joint_names, spec.kp, spec.kd)}
    gains |= {held.name: (held.kp, held.kd) for held in spec.held_joints}
    found = f"{spec.num_joints} joints, every {1e3 * spec.control_period_s:g} ms, sha256 {actor.actor.sha256[:12]}"
    too_stiff = [
        f"{gain} of {joint} is {asked:g}, its motor takes at most {limit:g}"
        for joint in gains
        for gain, asked, limit in zip(("kp", "kd"), gains[joint], info.gain_limits.get(joint, (math.inf, math.inf)))
        if asked > limit * (1.0 + GAIN_ROUNDING)
    ]
    fits = set(gains) == set(robot.joint_names) and not too_stiff
    return Check(f"actor {actor.name}", fits, "; ".join([found, *too_stiff[:3]]))


def _check_age(states: Sequence[RobotState], limit_s: float) -> Check:
    ages_s = [max(float(state.joint_age_s.max()), state.imu_age_s) for state in states]
    worst_s = max(ages_s)
    return Check("state age", worst_s < limit_s, f"at most {1e3 * worst_s:.1f} ms in {len(states)} readings")


def _check_faults(states: Sequence[RobotState]) -> Check:
    faults = sorted({fault for state in states for fault in state.faults})
    return Check("device faults", not faults, ", ".join(faults) or "none")


def _check_finite(states: Sequence[RobotState]) -> Check:
    last = states[-1]
    joints = (last.joint_pos_rad, last.joint_vel_rad_s, last.joint_torque_nm)
    values = (*joints, last.imu_quat_wxyz, last.imu_ang_vel_b, last.imu_acc_b)
    finite = all(bool(np.isfinite(value).all()) for value in values)
    unit = abs(float(np.linalg.norm(last.imu_quat_wxyz)) - 1.0) < 1e-3
    found = ("finite" if finite else "not finite") + ("" if unit else ", the quaternion is no rotation")
    return Check("numbers", finite and unit, found)


def _check_temperature(states: Sequence[RobotState], robot: Robot, settings: PreflightSettings) -> Check:
    heat = states[-1].temperature_c
    if heat is None or np.isnan(heat).all():
        return Check("temperatures", True, "not measured")
    joint = int(np.nanargmax(heat))
    found = f"hottest {robot.joint_names[joint]} at {heat[joint]:.0f} C, limit {settings.temperature_c:.0f} C"
    return Check("temperatures", bool(heat[joint] <= settings.temperature_c), found)


def _check_battery(states: Sequence[RobotState], settings: PreflightSettings) -> Check:
    last = states[-1]
    if (low := shortage(last, settings.battery)) is not None:
        return Check("battery", False, f"{low}: charge it")
    if (high := excess(last, settings.battery)) is not None:
        return Check("battery", False, f"{high}: check what supplies it, and `supply_v` in the robot's file")
    known = {"charge": last.charge, "supply": last.supply, "highest": last.supply_high}
    found = ", ".join(f"{what} {100.0 * share:.0f} %" for what, share in known.items() if math.isfinite(share))
    return Check("battery", True, found or "not reported")


def _boxes_line(actors: Sequence[ActorRun]) -> list[Check]:
    """A reminder, where a motion needs more than a floor: no sensor tells where its boxes are."""
    most = max((len(actor.scene.boxes) for actor in actors), default=0)
    return [Check("scene", True, f"{most} boxes, put up where the motion has them?")] if most else []


def _check_range(states: Sequence[RobotState], robot: Robot, settings: PreflightSettings) -> Check:
    pos = states[-1].joint_pos_rad
    excess = np.maximum(robot.pos_lower_rad - pos, pos - robot.pos_upper_rad)
    joint = int(np.argmax(excess))
    if excess[joint] <= settings.range_margin_rad:
        return Check("joint ranges", True, "all inside")
    return Check(
        "joint ranges", False, f"{robot.joint_names[joint]} at {pos[joint]:.2f} rad is {excess[joint]:.2f} outside"
    )


def _check_upright(states: Sequence[RobotState], settings: PreflightSettings) -> Check:
    """The mean of the directions that the quaternion calls up, against the base's own z."""
    up_z = -float(np.mean([projected_gravity(state.imu_quat_wxyz)[2] for state in states]))
    tilt = math.acos(min(1.0, max(-1.0, up_z)))
    found = f"leans by {tilt:.2f} rad, limit {settings.tilt_rad:g}"
    return Check("upright", tilt <= settings.tilt_rad, found)


def _check_gravity(states: Sequence[RobotState], settings: PreflightSettings) -> Check:
    """The accelerometer's mean against the direction that the quaternion calls up."""
    force_b = np.mean([state.imu_acc_b for state in states], axis=0)
    up_b = -np.mean([projected_gravity(state.imu_quat_wxyz) for state in states], axis=0)
    cosine = float(force_b @ up_b / max(float(np.linalg.norm(force_b) * np.linalg.norm(up_b)), 1e-9))
    angle = math.acos(min(1.0, max(-1.0, cosine)))
    found = f"{math.degrees(angle):.1f} degrees apart, limit {math.degrees(settings.gravity_rad):.0f}"
    return Check("gravity and quaternion", angle <= settings.gravity_rad, found)


def _check_acceleration(states: Sequence[RobotState], settings: PreflightSettings) -> Check:
    size = float(np.linalg.norm(np.mean([state.imu_acc_b for state in states], axis=0)))
    found = f"{size:.2f} m/s2, expected {GRAVITY_M_S2} within {settings.gravity_m_s2:g}"
    return Check("acceleration at rest", abs(size - GRAVITY_M_S2) <= settings.gravity_m_s2, found)
