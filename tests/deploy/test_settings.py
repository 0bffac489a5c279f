"""The deployment file is strict, and its promises cannot be configured away."""

import pytest
from omegaconf import OmegaConf

from core.config import CONFIGS
from core.errors import InputError
from deploy.settings import load_settings

DEFAULT = OmegaConf.load(CONFIGS / "deploy" / "default.yaml")


def changed(tmp_path, **changes):
    config = DEFAULT.copy()
    for key, value in changes.items():
        OmegaConf.update(config, key.replace("__", "."), value, force_add=True)
    path = tmp_path / "deploy.yaml"
    OmegaConf.save(config, path)
    return path


def test_the_thresholds_of_the_design():
    settings = load_settings()
    entry = settings.entry
    assert (entry.joint_rad, entry.joint_vel_rad_s, entry.tilt_rad, entry.ang_vel_rad_s) == (0.15, 2.0, 0.1, 0.3)
    stand_up = settings.stand_up
    assert (stand_up.max_error_rad, stand_up.max_tilt_rad, stand_up.speed_rad_s) == (0.5, 0.5, 0.8)
    assert settings.blend_s == 0.3 and settings.stand_up.ramp_s >= 1.0
    assert (settings.safety.stale.limit_periods, settings.safety.stale.trip_periods) == (2.0, 3.0)
    assert (settings.sequence.steady_ready_s, settings.sequence.hold_s) == (1.0, 2.0)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"stand_up__ramp_s": 0.5}, r"deploy\.yaml: stand_up\.ramp_s: too small, got 0\.5, expected at least 1\.0 s$"),
        (
            {"stand_up__speed_rad_s": 1.0},
            r"stand_up\.speed_rad_s: out of range, got 1\.0, expected a number in \[0\.0, 0\.8\] rad/s$",
        ),
        (
            {"safety__tilt__for_s": 0.6},
            r"safety\.tilt\.for_s: out of range, got 0\.6, expected a number in \[0\.0, 0\.5\] s$",
        ),
        ({"safety__tilt__max_rad": -1.0}, r"safety\.tilt\.max_rad: too small, got -1\.0, expected at least 0 rad$"),
        (
            {"safety__tilt__max_rad": "steep"},
            r"safety\.tilt\.max_rad: wrong type, got 'steep', expected a number in rad$",
        ),
        (
            {"safety__tilt__max_rad": float("nan")},
            r"safety\.tilt\.max_rad: not finite, got nan, expected a finite number$",
        ),
        ({"safety__luck": {"ticks": 1}}, r"safety\.luck: unknown key, expected one of torque_limit, .*battery$"),
        ({"blend_s": None}, r"blend_s: wrong type, got None, expected a number in s$"),
    ],
)
def test_unusable_values_are_named(tmp_path, change, says):
    with pytest.raises(InputError, match=says):
        load_settings(changed(tmp_path, **change))


def test_a_missing_file_is_named():
    with pytest.raises(InputError, match=r"no_such\.yaml"):
        load_settings("no_such.yaml")
