"""One motor of each protocol for the tests that run over all of them."""

from importlib.util import find_spec

from hal.can.codecs import make_codec

CODECS = {
    "damiao": make_codec("damiao", 5, "DM4310"),
    "robstride": make_codec("robstride", 5, "RS03"),
    "cubemars": make_codec("cubemars", 5, "AK80-9"),
    "odrive": make_codec("odrive", 5, "S1", enable_watchdog_endpoint=0x123, watchdog_timeout_endpoint=0x124),
}
if find_spec("moteus") is not None:
    CODECS["moteus"] = make_codec("moteus", 5, "r4", kp_nm_per_turn=600.0, kd_nm_s_per_turn=60.0, torque_nm=10.0)
