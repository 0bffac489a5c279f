"""CAN servos: codecs, buses, the driver and its robot file."""
