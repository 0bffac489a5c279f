"""Models: actuators, options, what stripping leaves, meshes."""

import mujoco
import numpy as np
import pytest

from core.errors import InputError
from robot.robot import load_robot
from tests.robot.toy import load_toy
from tests.shared_data import SHARED, needs_shared_data
from world.model import check_meshes, compile_model


@pytest.fixture(scope="module", params=["g1", "toy"])
def robot(request):
    return load_robot() if request.param == "g1" else load_toy()


def test_joint_table_order_is_the_state_order(robot):
    model = compile_model(robot, timestep_s=0.005)
    names = [model.joint(j).name for j in range(1, model.njnt)]
    assert tuple(names) == robot.joint_names
    assert np.array_equal(model.jnt_qposadr[1:], 7 + np.arange(robot.num_joints))
    assert np.array_equal(model.jnt_dofadr[1:], 6 + np.arange(robot.num_joints))
    assert [model.actuator(i).name for i in range(model.nu)] == names
    assert model.opt.timestep == 0.005


def test_torque_actuators_deliver_and_clip(robot):
    model = compile_model(robot, timestep_s=0.005)
    data = mujoco.MjData(model)
    for share, delivered in ((0.5, 0.5), (-0.5, -0.5), (3.0, 1.0), (-3.0, -1.0)):
        data.ctrl[:] = share * robot.torque_limit_nm
        mujoco.mj_forward(model, data)
        assert np.allclose(data.qfrc_actuator[6:], delivered * robot.torque_limit_nm)


def test_position_actuators_are_pd(robot):
    model = compile_model(robot, timestep_s=0.005, actuation="pd_position")
    data = mujoco.MjData(model)
    rng = np.random.default_rng(2)
    for scale in (0.02, 2.0):
        data.qpos[7:], data.qvel[6:] = rng.normal(size=(2, robot.num_joints)) * scale
        data.ctrl[:] = scale * rng.normal(size=robot.num_joints)
        mujoco.mj_forward(model, data)
        torque = robot.kp * (data.ctrl - data.qpos[7:]) - robot.kd * data.qvel[6:]
        assert np.allclose(data.qfrc_actuator[6:], np.clip(torque, -robot.torque_limit_nm, robot.torque_limit_nm))


def test_wrong_arguments_are_refused(robot):
    with pytest.raises(InputError, match="timestep_s, got 0"):
        compile_model(robot, timestep_s=0)
    with pytest.raises(InputError, match="got magic, expected one of pd_explicit, pd_position, torque"):
        compile_model(robot, timestep_s=0.005, actuation="magic")


def test_edit_sees_the_whole_spec(robot):
    def edit(spec):
        spec.geom("floor").friction[0] = 0.3
        spec.body(robot.root_body).mass *= 2

    plain, edited = compile_model(robot, timestep_s=0.005), compile_model(robot, timestep_s=0.005, edit=edit)
    assert plain.geom("floor").friction[0] == 1.0 and edited.geom("floor").friction[0] == 0.3
    assert np.isclose(edited.body_mass[1], 2 * plain.body_mass[1])


def test_stripping_changes_no_physics(robot):
    full = compile_model(robot, timestep_s=0.005)
    bare = compile_model(robot, timestep_s=0.005, strip_visuals=True)
    assert (bare.nmat, bare.ntex, bare.nmesh, bare.nlight) == (0, 0, 0, 0)
    assert bare.ngeom == ((full.geom_contype | full.geom_conaffinity) > 0).sum() < full.ngeom
    states = []
    for model in (full, bare):
        data = mujoco.MjData(model)
        data.qpos[2] += 0.05
        mujoco.mj_step(model, data, 200)
        states.append(np.concatenate([data.qpos, data.qvel]))
    assert np.array_equal(*states)


def test_shapes_weigh_nothing(robot):
    def heavier(spec):
        for geom in spec.geoms:
            geom.mass = 0

    a, b = compile_model(robot, timestep_s=0.005), compile_model(robot, timestep_s=0.005, edit=heavier)
    assert np.array_equal(a.body_mass, b.body_mass) and np.array_equal(a.body_inertia, b.body_inertia)


def test_every_moving_body_can_be_seen(robot):
    model = compile_model(robot, timestep_s=0.005)
    seen = model.geom_bodyid[(model.geom_group == 2) & (model.geom_contype == 0)]
    assert set(seen) >= set(range(1, model.nbody))


def test_options_fit_fast_stable_steps():
    model = compile_model(load_robot(), timestep_s=0.005)
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    assert np.allclose(model.site("imu_in_pelvis").pos, [0.04525, 0, -0.08339])


def test_the_robots_own_model_stands_on_nothing(robot):
    assert not (robot.model.geom_bodyid == 0).any()


@needs_shared_data
def test_the_makers_meshes_replace_the_shapes():
    robot = load_robot()
    folder = SHARED / "robot" / "meshes"
    model = compile_model(robot, timestep_s=0.005, meshes=folder)
    plain = compile_model(robot, timestep_s=0.005)
    assert model.nmesh == 2
    for side in ("left", "right"):
        body = model.body(f"{side}_ankle_roll_link").id
        shown = (model.geom_bodyid == body) & (model.geom_group == 2)
        assert list(model.geom_type[shown]) == [mujoco.mjtGeom.mjGEOM_MESH]
        assert (model.geom_contype[shown] == 0).all() and (model.geom_conaffinity[shown] == 0).all()
    assert np.array_equal(model.body_mass, plain.body_mass) and np.array_equal(model.body_inertia, plain.body_inertia)


def test_useless_mesh_folders_are_refused(tmp_path):
    robot = load_robot()
    with pytest.raises(InputError, match="meshes: no such folder"):
        compile_model(robot, timestep_s=0.005, meshes=tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"no mesh of this robot.*pelvis\.STL"):
        compile_model(robot, timestep_s=0.005, meshes=tmp_path)
    (tmp_path / "pelvis.STL").write_bytes(b"not a mesh" * 20)
    with pytest.raises(InputError, match=r"meshes .*: a mesh cannot be read, got .*pelvis\.STL") as caught:
        check_meshes(robot, tmp_path)
    assert "\n" not in str(caught.value)
