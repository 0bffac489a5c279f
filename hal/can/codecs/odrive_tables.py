"""Errors of an ODrive by bit, firmware 0.6."""

from hal.can import fault_names

ERRORS = {
    0: "initializing",
    1: "system",
    2: "timing",
    3: fault_names.ENCODER,
    4: "bad_config",
    5: fault_names.DRIVER,
    6: "missing_input",
    8: fault_names.OVER_VOLTAGE,
    9: fault_names.UNDER_VOLTAGE,
    10: fault_names.OVER_CURRENT,
    11: "regeneration_over_current",
    12: "current_limit",
    13: fault_names.MOTOR_OVER_TEMPERATURE,
    14: fault_names.DRIVER_OVER_TEMPERATURE,
    15: "velocity_limit",
    16: "position_limit",
    24: fault_names.COMMUNICATION_LOST,
    25: "emergency_stop",
    26: "spinout",
    27: "brake_resistor",
    28: "thermistor",
    30: fault_names.UNCALIBRATED,
}
ERROR_BITS = {name: bit for bit, name in ERRORS.items()}
