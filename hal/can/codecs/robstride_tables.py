"""RobStride motors: ranges of their fields, faults by bit, and the firmware from which gains are true."""

from hal.can import fault_names
from hal.can.codec import MotorModel

STATE_FAULTS = {
    16: fault_names.UNDER_VOLTAGE,
    17: fault_names.OVER_CURRENT,
    18: fault_names.MOTOR_OVER_TEMPERATURE,
    19: fault_names.ENCODER,
    20: fault_names.OVERLOAD,
    21: fault_names.UNCALIBRATED,
}
REPORTED_FAULTS = {
    0: fault_names.MOTOR_OVER_TEMPERATURE,
    1: fault_names.DRIVER,
    2: fault_names.UNDER_VOLTAGE,
    3: fault_names.OVER_VOLTAGE,
    4: fault_names.OVER_CURRENT,
    5: fault_names.OVER_CURRENT,
    7: fault_names.UNCALIBRATED,
    8: "hardware_id",
    9: fault_names.ENCODER,
    14: fault_names.OVERLOAD,
    16: fault_names.OVER_CURRENT,
}

MODELS = {
    name: MotorModel(name, pos, vel, torque, kp, kd)
    for name, pos, vel, torque, kp, kd in (
        ("RS00", 12.57, 33.0, 14.0, 500.0, 5.0),
        ("RS01", 12.57, 44.0, 17.0, 500.0, 5.0),
        ("RS02", 12.57, 44.0, 17.0, 500.0, 5.0),
        ("RS03", 12.57, 20.0, 60.0, 5000.0, 100.0),
        ("RS04", 12.57, 15.0, 120.0, 5000.0, 100.0),
        ("RS05", 12.57, 50.0, 5.5, 500.0, 5.0),
        ("RS06", 12.57, 50.0, 36.0, 5000.0, 100.0),
        ("CyberGear", 12.5, 30.0, 12.0, 500.0, 5.0),
    )
}
FIRST_TRUE_GAINS = {"RS01": (0, 1, 3, 4), "RS02": (0, 2, 3, 6)}
