"""Files and names: what is accepted and what is refused, with which words."""

from pathlib import Path

import pytest

from core.clock import SimulatedClock
from core.config import CONFIGS, config_file, load_options
from core.errors import InputError
from hal.open import BACKENDS, WIRES, open_backend
from hal.simulated.mock import MockBackend, MockOptions
from hal.simulated.mujoco import MujocoBackend
from hal.wire.backend import WireBackend
from tests.hal.rigs import G1
from world.options import load_sim_options

DEFAULT = (CONFIGS / "world" / "default.yaml").read_text(encoding="utf-8")


def test_bundled_simulations() -> None:
    default, reference = load_sim_options("default"), load_sim_options("reference")
    assert default.timestep_s == 0.001
    assert not default.report_only
    assert reference.timestep_s == 0.005
    assert reference.report_only
    for options in (default, reference):
        assert (options.friction, options.command_delay_s, options.push_speed_m_s) == (None, None, None)
        assert options.push_interval_s == 5.0
        assert not options.randomize


def test_randomisation_is_the_papers_and_the_released_configs() -> None:
    r = load_sim_options().randomization
    assert r.friction == (0.6, 1.1)
    assert r.kp_scale == r.kd_scale == r.mass_scale == r.inertia_scale == (0.9, 1.1)
    assert (r.com_xy_m, r.com_z_m) == (0.05, 0.01)
    assert r.delay_s == (0.0, 0.04)
    assert (r.torque_noise, r.torque_offset, r.torque_noise_scale) == (0.05, 0.05, (0.5, 1.5))
    assert (r.push_speed_m_s, r.push_interval_s) == (0.1, (5.0, 10.0))
    n = r.noise
    assert (n.joint_pos_rad, n.joint_vel_rad_s, n.ang_vel_rad_s, n.gravity) == (0.01, 1.0, 0.3, 0.2)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("timestep_s: 0.001", "timestep: 0.001", "timestep: unknown key, expected one of timestep_s, report_only"),
        ("timestep_s: 0.001", "", "timestep_s: missing key"),
        ("timestep_s: 0.001", "timestep_s: fast", "timestep_s: wrong type, got 'fast', expected a number in s"),
        ("timestep_s: 0.001", "timestep_s: -1", "timestep_s: too small, got -1.0, expected at least 0 s"),
        ("timestep_s: 0.001", "timestep_s: .nan", "timestep_s: not finite, got nan"),
        ("report_only: false", "report_only: 1", "report_only: wrong type, got 1, expected true or false"),
        ("friction: null", "friction: -0.2", "friction: too small, got -0.2"),
        ("friction: null", "friction: 0", "friction: too small, got 0.0, expected at least 1e-05"),
        (
            "friction: [0.6, 1.1]",
            "friction: [0, 1.1]",
            "randomization.friction: too small, got 0.0, expected at least 1e-05",
        ),
        ("gravity: 0.0}", "gravity: 0.0, gravitas: 1}", "noise.gravitas: unknown key"),
        ("support: 0.6", "support: 1.6", "gantry.support: out of range, got 1.6"),
        ("friction: [0.6, 1.1]", "friction: [1.1, 0.6]", "randomization.friction: not a range, got [1.1, 0.6]"),
        (
            "friction: [0.6, 1.1]",
            "friction: [1.1]",
            "randomization.friction: wrong length, got [1.1], expected a list of 2 numbers",
        ),
        ("friction: [0.6, 1.1]", "friction: 1.1", "randomization.friction: wrong type, got 1.1, expected a list"),
        ("gantry:", "gantry: 3\nrope:", "rope: unknown key"),
        ("timestep_s: 0.001", "timestep_s: [", "not a readable YAML file"),
    ],
)
def test_a_bad_file_is_refused_by_name_of_file_and_entry(tmp_path: Path, old: str, new: str, text: str) -> None:
    path = tmp_path / "mine.yaml"
    assert old in DEFAULT
    path.write_text(DEFAULT.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError) as error:
        load_sim_options(path)
    assert str(error.value).startswith(f"{path}: ") and text in str(error.value)
    assert "\n" not in str(error.value)


def test_a_good_file_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(DEFAULT.replace("timestep_s: 0.001", "timestep_s: 2e-3", 1), encoding="utf-8")
    assert load_sim_options(path).timestep_s == 0.002


def test_unknown_names_list_what_there_is(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"unknown world configuration, got moon, expected one of default, reference"):
        load_sim_options("moon")
    with pytest.raises(InputError, match=r"gone\.yaml: no such file"):
        load_sim_options(tmp_path / "gone.yaml")
    with pytest.raises(InputError, match=r"unknown backend, got teleport, expected one of mock, mujoco"):
        open_backend("teleport", G1, SimulatedClock())


def test_backends_by_name() -> None:
    elsewhere = {"dds": {"interface": "lo", "domain": "1"}, "dynamixel": {"left_leg": "elsewhere"}}
    made = {name: open_backend(name, G1, SimulatedClock(), endpoints=elsewhere.get(name)) for name in BACKENDS}
    assert isinstance(made["mock"], MockBackend)
    assert isinstance(made["mujoco"], MujocoBackend)
    assert made["mujoco"].options == load_sim_options()
    assert all(isinstance(made[name], WireBackend) for name in WIRES)


def test_mock_takes_no_simulation_model(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="simulation model"):
        open_backend("mock", G1, SimulatedClock(), sim_model=tmp_path / "any.xml")


def test_faults_can_be_written_in_the_mocks_file(tmp_path: Path) -> None:
    path = tmp_path / "broken.yaml"
    text = config_file("hal", "mock").read_text(encoding="utf-8")
    path.write_text(
        text.replace("faults: []", "faults:\n  - {kind: stale_joint, start_s: 3, joint: left_knee_joint}"),
        encoding="utf-8",
    )
    fault = load_options(MockOptions, path).faults[0]
    assert (fault.kind, fault.start_s, fault.duration_s, fault.joint) == (
        "stale_joint",
        3.0,
        float("inf"),
        "left_knee_joint",
    )
    path.write_text(text.replace("faults: []", "faults: [{kind: tilt, start_s: -1}]"), encoding="utf-8")
    with pytest.raises(InputError, match=r"broken\.yaml: faults\[0 tilt\]\.start_s: too small, got -1\.0"):
        load_options(MockOptions, path)
    path.write_text(text.replace("joint_lag_s: 0.2", "joint_lag_s: 0"), encoding="utf-8")
    with pytest.raises(
        InputError, match=r"broken\.yaml: joint_lag_s: not positive, got 0\.0, expected a number above 0 s"
    ):
        load_options(MockOptions, path)
