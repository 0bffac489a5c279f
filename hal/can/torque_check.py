"""Whether a motor gives the torque that its commands ask for, by its own word.

A motor that reads gains by other ranges than the file's answers with another torque than kp (q* - q) + kd (dq* - dq)
+ tau. That is the last net under the models: where a protocol says its ranges, they were compared before.
"""

from hal.can.codec import MotorCommand

ANSWERS = 50
LEAST_SHARE, MOST_SHARE = 0.05, 0.5
FACTOR = 1.8


class TorqueCheck:
    """Judges once, over the first 50 answers that tell something; until then, and where all is well, it is silent.

    An answer tells something where asked or measured torque is above 5 % of what the motor may give, and the asked one
    below 50 %, where no motor saturates. The first answer to a new command does not: its torque was measured before.
    """

    def __init__(self, torque_nm: float) -> None:
        """torque_nm: what the motor may give, at its shaft."""
        self._least_nm, self._most_nm = LEAST_SHARE * torque_nm, MOST_SHARE * torque_nm
        self._command: MotorCommand | None = None
        self._answers, self._asked_nm, self._given_nm = 0, 0.0, 0.0

    def hear(self, command: MotorCommand, pos_rad: float, vel_rad_s: float, torque_nm: float) -> None:
        """What the motor measured while the command was in force, all at its shaft."""
        is_new, self._command = command is not self._command, command
        if is_new or self._answers >= ANSWERS:
            return
        spring_nm = command.kp * (command.q_rad - pos_rad)
        asked_nm = abs(spring_nm + command.kd * (command.dq_rad_s - vel_rad_s) + command.tau_nm)
        given_nm = abs(torque_nm)
        if asked_nm < self._most_nm and max(asked_nm, given_nm) > self._least_nm:
            self._answers += 1
            self._asked_nm += asked_nm
            self._given_nm += given_nm

    @property
    def problem(self) -> str | None:
        """What is wrong, None where nothing is known to be."""
        asked, given = self._asked_nm, self._given_nm
        if self._answers < ANSWERS or asked < FACTOR * given < FACTOR * FACTOR * asked:
            return None
        share = given / asked if asked else float("inf")
        return (
            f"gives {share:.2f} times the torque that its commands ask for: another model than the robot file's,"
            " or other ranges in the motor"
        )
