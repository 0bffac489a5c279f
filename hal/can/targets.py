"""A robot's command as commands to the motors of one bus."""

import numpy as np

from hal.can.codec import MotorCommand
from hal.contract.joint_map import JointMap
from hal.wire.outbox import Kind, Outgoing
from world.actuation import JointCommand


class MotorTargets:
    """Worked out once for each command, however often it is repeated.

    index: (N,) where each motor's joint stands in a command. torque_nm: (N,) limits of the feed-forward, at the joint.
    """

    def __init__(self, index: np.ndarray, torque_nm: np.ndarray) -> None:
        self._index, self._torque_nm = index, torque_nm
        self._made: tuple[Outgoing | None, list[MotorCommand]] = (None, [])

    def of(self, outgoing: Outgoing, mapped: JointMap) -> list[MotorCommand]:
        """One per motor; empty where there is nothing to track."""
        if outgoing.kind is not Kind.TRACK or outgoing.command is None:
            self._made = (None, [])
        elif self._made[0] is not outgoing:
            command, index = outgoing.command, self._index
            tau_nm = command.tau_nm.copy()
            tau_nm[index] = np.clip(tau_nm[index], -self._torque_nm, self._torque_nm)
            limited = JointCommand(command.q_rad, command.dq_rad_s, command.kp, command.kd, tau_nm)
            raw = mapped.raw_command(limited, index)
            columns = np.column_stack((raw.q_rad, raw.dq_rad_s, raw.kp, raw.kd, raw.tau_nm))
            self._made = (outgoing, [MotorCommand(*row) for row in columns.tolist()])
        return self._made[1]
