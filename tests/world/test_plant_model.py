"""Any MJCF with the robot's joints is a simulation model; anything else is refused with the reason."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from core.clock import SimulatedClock
from core.errors import InputError
from hal.simulated.mujoco import MujocoBackend
from tests.hal.rigs import G1, UPRIGHT, hold, mujoco_backend, run, sim_options
from tests.robot.toy import load_toy
from tests.shared_data import SHARED, needs_shared_data
from world.model import build_spec
from world.plant_model import build_plant_model

TOY = load_toy()
FLOOR = '<worldbody><geom name="ground" type="plane" size="0 0 1" friction="1 0.005 0.0001"/>'


def toy_text(**changes: str) -> str:
    """The toy's own file with a floor, and texts replaced."""
    text = Path(TOY.mjcf_path).read_text(encoding="utf-8").replace("<worldbody>", FLOOR, 1)
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    return text


def written(folder: Path, text: str) -> Path:
    path = folder / "model.xml"
    path.write_text(text, encoding="utf-8")
    return path


def stand(model_file: Path | None, gantry: bool = False) -> np.ndarray:
    backend = MujocoBackend(TOY, SimulatedClock(), sim_options(), sim_model=model_file, gantry=gantry)
    with backend:
        return run(backend, hold(TOY), 0.4).joint_pos_rad


def test_the_robots_own_file_behaves_like_the_built_in_model(tmp_path: Path) -> None:
    np.testing.assert_allclose(stand(written(tmp_path, toy_text())), stand(None), atol=1e-9)


def test_the_files_own_actuators_sensors_and_keys_do_not_count(tmp_path: Path) -> None:
    extra = """<actuator><position joint="left_hip" kp="500" ctrlrange="-1 1"/></actuator>
        <sensor><actuatorfrc actuator="left_hip_motor"/></sensor>
        <actuator><motor name="left_hip_motor" joint="left_hip" gear="7"/></actuator>
        <keyframe><key name="home" ctrl="1 2"/></keyframe></mujoco>"""
    path = written(tmp_path, toy_text(**{"</mujoco>": extra}))
    np.testing.assert_allclose(stand(path), stand(None), atol=1e-9)


def test_joints_are_matched_by_name_not_by_place(tmp_path: Path) -> None:
    """The right leg comes first in this file."""
    text = toy_text()
    left = re.search(r'<body name="left_leg".*?</body>\s*</body>', text, re.S)
    right = re.search(r'<body name="right_leg".*?</body>\s*</body>', text, re.S)
    assert left is not None
    assert right is not None
    swapped = text[: left.start()] + right.group() + left.group() + text[right.end() :]
    path = written(tmp_path, swapped)
    target = TOY.default_pos_rad + np.array([0.1, -0.1, 0.2, 0.05])
    ends = []
    for model_file in (path, None):
        backend = MujocoBackend(TOY, SimulatedClock(), sim_options(), sim_model=model_file, gantry=False)
        with backend:
            backend.reset_to(np.array([0, 0, 5.0]), UPRIGHT, TOY.default_pos_rad)
            state = run(backend, hold(TOY, target), 0.3)
            ends.append((state.joint_pos_rad, state.truth.root_pos_w))
    assert mujoco.MjModel.from_xml_path(str(path)).joint(1).name == "right_hip"
    np.testing.assert_allclose(ends[0][0], ends[1][0], atol=1e-9)
    np.testing.assert_allclose(ends[0][1], ends[1][1], atol=1e-9)


def test_the_torque_limits_are_those_of_the_joint_table() -> None:
    model = build_plant_model(G1, sim_options())
    np.testing.assert_array_equal(model.actuator_forcerange[:, 1], G1.torque_limit_nm)
    np.testing.assert_array_equal(model.actuator_forcerange[:, 0], -G1.torque_limit_nm)
    assert [model.actuator(i).name for i in range(model.nu)] == list(G1.joint_names)


@needs_shared_data
def test_the_published_model_works_with_and_without_gantry() -> None:
    path = SHARED / "robot" / "g1_23dof_reference.xml"
    for gantry in (False, True):
        backend = MujocoBackend(G1, SimulatedClock(), sim_options("reference"), sim_model=path, gantry=gantry)
        with backend:
            state = run(backend, hold(G1), 0.5)
            assert state.truth.foot_contact.all()
            assert state.truth.root_pos_w[2] > 0.7


def test_a_gantry_works_on_any_file(tmp_path: Path) -> None:
    np.testing.assert_allclose(stand(written(tmp_path, toy_text()), gantry=True), stand(None, gantry=True), atol=1e-9)


HIP = '<joint name="left_hip" class="hip"/>'
CASES = {
    "renamed joint": ({'name="left_hip"': 'name="hip_of_the_left"'}, "missing joints left_hip; extra joints hip_of"),
    "joint too many": ({HIP: f'{HIP}<joint name="more" axis="1 0 0"/>'}, "extra joints more"),
    "fixed base": ({'<freejoint name="float"/>': ""}, "number of free joints, got 0, expected 1"),
    "slide": ({HIP: HIP.replace("/>", ' type="slide"/>')}, "no hinges, got left_hip"),
    "renamed foot": ({'body name="left_foot"': 'body name="left_paw"'}, "missing bodies left_foot"),
    "no ground": ({FLOOR: "<worldbody>"}, "no ground"),
    "no xml": ({"</mujoco>": ""}, "is no MJCF"),
    "renamed root": ({'body name="trunk"': 'body name="torso"'}, "missing bodies trunk"),
}


@pytest.mark.parametrize("case", CASES)
def test_an_unfit_file_is_refused_with_file_and_reason(case: str, tmp_path: Path) -> None:
    changes, reason = CASES[case]
    path = written(tmp_path, toy_text(**changes))
    with pytest.raises(InputError, match=re.escape(reason)) as error:
        build_plant_model(TOY, sim_options(), sim_model=path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere\.xml: no such file"):
        build_plant_model(TOY, sim_options(), sim_model=tmp_path / "nowhere.xml")


def test_another_robots_file_names_all_missing_joints(tmp_path: Path) -> None:
    spec = build_spec(TOY)
    spec.compile()
    path = written(tmp_path, spec.to_xml())
    with pytest.raises(InputError) as error:
        build_plant_model(G1, sim_options(), sim_model=path)
    assert all(name in str(error.value) for name in G1.joint_names)


def test_an_explosion_is_not_hidden_by_a_silent_reset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into the working folder
    backend = mujoco_backend(robot=TOY)
    backend.open()
    backend.data.qvel[:] = 1e9
    backend.clock.sleep_until(0.01)
    assert not np.isfinite(backend.read().joint_pos_rad).all() or np.abs(backend.data.qpos).max() > 1e3


@needs_shared_data
def test_the_makers_meshes_are_seen_and_change_no_physics() -> None:
    states = []
    for meshes in (None, SHARED / "robot" / "meshes"):
        backend = MujocoBackend(G1, SimulatedClock(), sim_options(push_speed_m_s=0.5), gantry=True, meshes=meshes)
        with backend:
            backend.hang()
            run(backend, hold(G1), 0.5)
            backend.release_gantry()
            run(backend, hold(G1), 0.5)
            states.append(np.concatenate([backend.data.qpos, backend.data.qvel]))
        assert backend.model.nmesh == (0 if meshes is None else 2)
    np.testing.assert_array_equal(*states)
