"""Finding and calibrating servos, one joint at a time, with low torque and the operator's consent."""
