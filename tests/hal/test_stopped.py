"""How commands end on Ctrl-C: with 130 where nothing can move, in order where something may."""

import pytest

from hal.calibration import scan, zero
from hal.dynamixel import zero as dynamixel_zero


@pytest.mark.parametrize(("module", "begins", "code"), [
    (scan, "_parser", 130), (dynamixel_zero, "_parser", 130), (zero, "_parser", 0),
])  # fmt: skip
def test_ctrl_c(module, begins, code, monkeypatch, capsys):
    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, begins, stopped)
    assert module.main(["left_knee_joint"]) == code
    assert capsys.readouterr().err == "stopped\n"
