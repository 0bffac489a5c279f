"""PBHC's released actors: a small config for the errors, and the authors' own actor where it is at hand."""

import numpy as np
import pytest
import yaml

from core.errors import InputError
from policy.actor import load_actor
from policy.adapters.pbhc import read_config
from policy.controller import PolicyController
from policy.layouts import pbhc_actor_group
from policy.observation import observation_layout, term_dims
from policy.spec import MotionInfo, ObservationTerm
from robot.robot import load_robot
from tests.policy.toys import toy_motion, toy_robot, write_graph
from tests.shared_data import SHARED, needs_shared_data

RELEASE = SHARED / "pbhc" / "actor_horse_stance_pose"


def small_config() -> dict:
    return {
        "timestamp": "${now:%Y}",
        "experiment_name": "Bow",
        "env": {"config": {"normalization": {"clip_observations": 50.0}}},
        "robot": {
            "num": "${eval:'3 * ${robot.dof_obs_size}'}",
            "missing": "???",
            "dof_names": ["hip", "knee", "ankle"],
            "init_state": {"default_joint_angles": {"ankle": -0.2, "hip": -0.1, "knee": 0.3}},
            "control": {
                "control_type": "P",
                "isaac_pd_scale": False,
                "stiffness": {"kne": 150, "hip": 100, "ankle": 40},
                "damping": {"hip": 2.0, "kne": 4.0, "ankle": 1e-1},
                "action_scale": 0.25,
                "action_clip_value": 90.0,
            },
        },
        "simulator": {"config": {"sim": {"fps": 200, "control_decimation": 4}}},
        "obs": {
            "obs_dict": {"actor_obs": ["dof_vel", "history_actor", "actions", "ref_motion_phase"]},
            "obs_auxiliary": {"history_actor": {"dof_vel": 2, "actions": 3}},
            "obs_scales": {"dof_vel": 0.05, "actions": 1.0, "history_actor": 1.0, "ref_motion_phase": 1},
        },
    }


def write_config(folder, config) -> None:
    (folder / "config.yaml").write_text(yaml.safe_dump(config))


def with_value(key: str, value) -> dict:
    """The small config with the dotted ``key`` set, or removed for None."""
    config = small_config()
    *parents, last = key.split(".")
    node = config
    for parent in parents:
        node = node[parent]
    if value is None:
        del node[last]
    else:
        node[last] = value
    return config


def test_a_config_becomes_a_spec(tmp_path):
    write_config(tmp_path, small_config())
    spec = read_config(tmp_path / "config.yaml", ["actor_obs"], "toy")
    assert spec.joint_names == ("hip", "knee", "ankle")
    assert spec.default_pos_rad.tolist() == [-0.1, 0.3, -0.2]
    assert spec.kp.tolist() == [100.0, 150.0, 40.0]
    assert spec.kd.tolist() == [2.0, 4.0, 0.1]
    assert spec.action_scale.tolist() == [0.25] * 3
    assert (spec.action_clip, spec.control_period_s, spec.history_start) == (90.0, 0.02, "zeros")
    assert spec.motion is None
    (group,) = spec.observations
    assert group.name == "actor_obs"
    assert group.terms == (
        ObservationTerm("actions", (0,), 1.0, 50.0),
        ObservationTerm("dof_vel", (0,), 0.05, 50.0),
        ObservationTerm("actions", (1, 2, 3), 1.0, 50.0),
        ObservationTerm("dof_vel", (1, 2), 0.05, 50.0),
        ObservationTerm("ref_motion_phase", (0,), 1.0, 50.0),
    )


def test_the_actor_beside_it_loads_with_a_motion_only(tmp_path):
    write_config(tmp_path, small_config())
    path = write_graph(tmp_path / "model.onnx", 3 + 3 + 9 + 6 + 1, name="actor_obs")
    with pytest.raises(InputError) as caught:
        load_actor(path, toy_robot())
    assert str(caught.value) == f"{path}: this actor carries no reference motion: give --motion"
    actor = load_actor(path, toy_robot(), toy_motion())
    assert actor.spec.motion.name == "bow"
    assert actor.motion_npz is None
    write_graph(path, 21, name="actor_obs")
    with pytest.raises(InputError, match=r"graph input 'actor_obs': wrong size, got \[1, 21\], expected \[1, 22\]"):
        load_actor(path, toy_robot(), toy_motion())


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("robot.dof_names", None, "robot.dof_names: missing key, got control, init_state"),
        ("robot.dof_names", "hip", "robot.dof_names: wrong type, got 'hip', expected a list"),
        (
            "robot.init_state.default_joint_angles.ankle",
            None,
            "robot.init_state.default_joint_angles: joints differ from robot.dof_names, got ankle",
        ),
        ("robot.control.stiffness.kne", None, "robot.control.stiffness: no single gain for knee, got none, expected "),
        ("robot.control.stiffness.k", 3.0, "robot.control.stiffness: no single gain for knee, got k, kne, expected "),
        ("robot.control.damping.kne", "stiff", "robot.control.damping.kne: wrong type, got 'stiff', expected a number"),
        ("robot.control.damping.kne", -1.0, "kd: not usable, got knee -1.0, expected 0 or more"),
        ("robot.control.control_type", "T", "robot.control.control_type: unknown choice, got T, expected one of P"),
        (
            "robot.control.isaac_pd_scale",
            True,
            "robot.control.isaac_pd_scale: unknown choice, got True, expected one of False",
        ),
        ("simulator.config.sim.fps", "${fps}", "simulator.config.sim.fps: wrong type, got '${fps}', expected a number"),
        ("simulator.config.sim.fps", 0, "simulator.config.sim.fps: not positive, got 0.0, expected a number above 0"),
        ("obs.obs_dict.actor_obs", None, "obs.obs_dict.actor_obs: missing key, got nothing"),
        ("obs.obs_dict.actor_obs", ["dof_vel", "yaw"], "obs.obs_scales.yaw: wrong type, got None, expected a number"),
        ("obs.obs_scales.actions", None, "obs.obs_scales.actions: wrong type, got None, expected a number"),
        (
            "obs.obs_auxiliary.history_actor",
            4,
            "obs.obs_auxiliary.history_actor: wrong type, got 4, expected a mapping",
        ),
        (
            "obs.obs_auxiliary.history_actor.actions",
            0,
            "obs.obs_auxiliary.history_actor.actions: out of range, got 0, expected a number in [1, 1000]",
        ),
        (
            "obs.obs_auxiliary.history_actor.actions",
            2.5,
            "obs.obs_auxiliary.history_actor.actions: wrong type, got 2.5, expected a whole number",
        ),
    ],
)
def test_an_unusable_config_is_refused(tmp_path, key, value, text):
    write_config(tmp_path, with_value(key, value))
    with pytest.raises(InputError) as caught:
        read_config(tmp_path / "config.yaml", ["actor_obs"], "toy")
    assert str(caught.value).startswith(f"{tmp_path / 'config.yaml'}: {text}")


def test_an_unknown_term_of_theirs_is_refused(tmp_path):
    config = with_value("obs.obs_dict.actor_obs", ["dof_vel", "dif_joint_pos"])
    config["obs"]["obs_scales"]["dif_joint_pos"] = 1.0
    write_config(tmp_path, config)
    text = r"unknown observation term, got dif_joint_pos, expected one of actions, base_ang_vel, "
    with pytest.raises(InputError, match=text):
        read_config(tmp_path / "config.yaml", ["actor_obs"], "toy")


@pytest.mark.parametrize("content", [b"a: [", b"\xff\xfe\x00", b"a: 1\na: 2", b"!!python/object/apply:os.getcwd []"])
def test_a_config_that_is_no_yaml_is_refused(tmp_path, content):
    (tmp_path / "config.yaml").write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_config(tmp_path / "config.yaml", ["actor_obs"], "toy")
    assert str(caught.value).startswith(f"{tmp_path / 'config.yaml'}: not a readable YAML file, got ")
    assert "\n" not in str(caught.value)


def test_a_config_that_is_a_list_is_refused(tmp_path):
    (tmp_path / "config.yaml").write_text("[1, 2]")
    with pytest.raises(InputError, match=r"config\.yaml: wrong type, got a list, expected a mapping"):
        read_config(tmp_path / "config.yaml", ["actor_obs"], "toy")


@needs_shared_data
def test_the_released_config_is_the_layout_of_the_design():
    spec = read_config(RELEASE / "config.yaml", ["actor_obs"], "g1_23dof")
    assert spec.observations == (pbhc_actor_group(),)
    assert observation_layout(spec.observations[0], term_dims(23)).size == 380
    robot = load_robot()
    order = robot.joint_index(spec.joint_names)
    for name in ("default_pos_rad", "kp", "kd"):
        assert getattr(spec, name)[order].tolist() == getattr(robot, name).tolist()


@needs_shared_data
def test_the_released_actor_tracks_its_clip():
    """Closed loop in plain MuJoCo, without any of this project's simulation; the reference is the data's own table:
    Eg 56.5 mm, Empbpe 17.7 mm from the exact start (chaotic, hence the band), joints 475.6e-3 rad."""
    mujoco = pytest.importorskip("mujoco")
    library = pytest.importorskip("motion.library")
    resample = pytest.importorskip("motion.resample")
    robot = load_robot()
    clip = library.open_motion(SHARED / "pbhc" / "Horse-stance_pose.pkl", robot)
    order = robot.joint_index(clip.joint_names)
    info = MotionInfo(
        name="Horse-stance_pose",
        fps=clip.fps,
        num_frames=clip.num_frames,
        duration_s=clip.duration_s,
        sha256=clip.sha256,
        root_height_m=float(clip.root_pos_w[0, 2]),
        start_joint_pos_rad=clip.joint_pos_rad[0, order],
    )
    controller = PolicyController(load_actor(RELEASE / "model_50000.onnx", robot, info), robot)
    ticks = int(clip.duration_s / 0.02)
    assert ticks == 348
    samples = resample.sample_clip(clip, 0.02 * np.arange(ticks + 1))
    reference = np.concatenate([samples.root_pos_w, samples.root_quat_wxyz, samples.joint_pos_rad[:, order]], 1)
    model = mujoco.MjModel.from_xml_path(str(SHARED / "robot" / "g1_23dof_reference.xml"))
    eg_mm, rel_mm, joint_mrad = closed_loop_errors(mujoco, model, controller, robot, reference, clip.duration_s)
    assert eg_mm == pytest.approx(56.5, rel=0.25)
    assert rel_mm == pytest.approx(17.7, rel=0.25)
    assert joint_mrad == pytest.approx(475.6, rel=0.08)


def closed_loop_errors(mujoco, model, controller, robot, reference, duration_s):
    """Means over the ticks of (Eg mm, Empbpe mm, joint error 1e-3 rad); ``reference`` (T+1, 7+23) are positions."""
    names = [model.joint(i).name for i in range(1, model.njnt)]
    assert tuple(names) == robot.joint_names
    model.opt.timestep = 0.005
    data, ghost = mujoco.MjData(model), mujoco.MjData(model)
    data.qpos[:] = reference[0]
    mujoco.mj_forward(model, data)
    errors = []
    for tick in range(len(reference) - 1):
        phase = min(1.0, tick * 0.02 / duration_s)
        output = controller.act(data.qpos[3:7], data.qvel[3:6], data.qpos[7:], data.qvel[6:], phase)
        for _ in range(4):
            torque = output.kp * (output.target_rad - data.qpos[7:]) - output.kd * data.qvel[6:]
            data.ctrl[:] = np.clip(torque, -robot.torque_limit_nm, robot.torque_limit_nm)
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        ghost.qpos[:] = reference[tick + 1]
        mujoco.mj_kinematics(model, ghost)
        now, wanted = tracked(data, robot), tracked(ghost, robot)
        assert data.qpos[2] > 0.3
        relative = (now - now[0]) - (wanted - wanted[0])
        joints = np.linalg.norm(data.qpos[7:] - reference[tick + 1, 7:])
        errors.append(
            [
                1e3 * np.linalg.norm(now - wanted, axis=1).mean(),
                1e3 * np.linalg.norm(relative, axis=1).mean(),
                1e3 * joints,
            ]
        )
    return np.mean(errors, axis=0)


def tracked(data, robot):
    """The 27 tracked points (27, 3), the pelvis first."""
    bodies = [data.body(name).xpos for name in robot.body_names]
    points = [
        data.body(p.parent).xpos + data.body(p.parent).xmat.reshape(3, 3) @ np.asarray(p.offset_m) for p in robot.points
    ]
    return np.array(bodies + points)
