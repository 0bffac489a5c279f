"""Errors of an ODrive by bit, firmware 0.6."""

from hal.can import codec

ERRORS = {
    0: "initializing",
    1: "system",
    2: "timing",
    3: codec.ENCODER,
    4: "bad_config",
    5: codec.DRIVER,
    6: "missing_input",
    8: codec.OVER_VOLTAGE,
    9: codec.UNDER_VOLTAGE,
    10: codec.OVER_CURRENT,
    11: "regeneration_over_current",
    12: "current_limit",
    13: codec.MOTOR_OVER_TEMPERATURE,
    14: codec.DRIVER_OVER_TEMPERATURE,
    15: "velocity_limit",
    16: "position_limit",
    24: codec.COMMUNICATION_LOST,
    25: "emergency_stop",
    26: "spinout",
    27: "brake_resistor",
    28: "thermistor",
    30: codec.UNCALIBRATED,
}
ERROR_BITS = {name: bit for bit, name in ERRORS.items()}
