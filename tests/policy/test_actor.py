import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto

import policy.actor
from core.errors import InputError
from policy.actor import bundled_actors, load_actor
from policy.spec import ObservationGroup, ObservationTerm
from policy.spec_json import spec_to_json
from tests.policy.toys import (
    GROUP,
    JOINTS,
    SIZE,
    set_metadata,
    toy_motion,
    toy_robot,
    toy_spec,
    weights,
    write_actor,
    write_graph,
)

ROBOT = toy_robot()


def refusal(path, robot=ROBOT, motion=None) -> str:
    with pytest.raises(InputError) as caught:
        load_actor(path, robot, motion)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def by_numpy(params, obs):
    w1, b1, w2, b2 = (p.astype(np.float64) for p in params)
    return w2 @ np.tanh(w1 @ obs.astype(np.float64) + b1) + b2


def test_a_good_actor_loads_and_infers(tmp_path):
    path = write_actor(tmp_path / "a.onnx", motion_npz=b"the clip")
    actor = load_actor(path, ROBOT)
    assert actor.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert actor.motion_npz == b"the clip"
    assert actor.path == path
    assert spec_to_json(actor.spec) == spec_to_json(toy_spec())
    obs = np.random.default_rng(0).normal(size=SIZE).astype(np.float32)
    action = actor.infer({"obs": obs}).action
    assert action.shape == (3,) and action.dtype == np.float32
    np.testing.assert_allclose(action, by_numpy(weights(), obs), atol=1e-5)


@pytest.mark.parametrize("value", [1e6, -1e6, 1e-310, -1e-45, 0.0, 100.0])
def test_extreme_observations_give_finite_actions(tmp_path, value):
    actor = load_actor(write_actor(tmp_path / "a.onnx"), ROBOT)
    obs = np.full(SIZE, value, np.float32)
    np.testing.assert_allclose(actor.infer({"obs": obs}).action, by_numpy(weights(), obs), atol=1e-5)


def test_a_nan_comes_out_as_it_is(tmp_path):
    actor = load_actor(write_actor(tmp_path / "a.onnx"), ROBOT)
    assert np.isnan(actor.infer({"obs": np.full(SIZE, np.nan, np.float32)}).action).all()


def test_inference_starts_no_threads(tmp_path):
    tasks = Path("/proc/self/task")
    if not tasks.is_dir():
        pytest.skip("no /proc")
    path = write_actor(tmp_path / "a.onnx")
    before = len(list(tasks.iterdir()))
    actor = load_actor(path, ROBOT)
    actor.infer({"obs": np.zeros(SIZE, np.float32)})
    assert len(list(tasks.iterdir())) == before
    options = actor.session.get_session_options()
    assert (options.intra_op_num_threads, options.inter_op_num_threads) == (1, 1)


def test_a_bundled_name_comes_before_a_file_and_unknown_names_list_them(tmp_path, monkeypatch):
    monkeypatch.setattr(policy.actor, "ACTORS_DIR", tmp_path)
    for name in ("wave", "bow"):
        (tmp_path / name).mkdir()
        write_actor(tmp_path / name / "actor.onnx")
    assert bundled_actors() == ["bow", "wave"]
    assert load_actor("bow", ROBOT).path == tmp_path / "bow" / "actor.onnx"
    expected = "expected a bundled actor (bow, wave) or an .onnx file"
    assert refusal("taichi") == f"taichi: no such actor, {expected}"
    assert refusal(tmp_path / "bow") == f"{tmp_path / 'bow'}: is a folder, not an actor, {expected}"


def test_what_is_no_model_is_refused(tmp_path):
    path = tmp_path / "a.onnx"
    path.write_bytes(b"junk")
    assert refusal(path).startswith(f"{path}: cannot be loaded (")
    path.write_bytes(b"")
    assert refusal(path).startswith(f"{path}: cannot be loaded (")
    write_graph(path)
    assert refusal(path) == (
        f"{path}: not a known kind of actor, expected metadata 'actor_spec', or a PBHC config.yaml beside the file, "
        "or the flat metadata of an mjlab or BeyondMimic tracking actor"
    )


def test_a_truncated_file_is_refused(tmp_path):
    path = write_actor(tmp_path / "a.onnx")
    path.write_bytes(path.read_bytes()[:-40])
    assert str(path) in refusal(path)


def test_an_operator_set_from_the_future_is_refused(tmp_path):
    path = write_graph(tmp_path / "a.onnx")
    model = onnx.load(str(path))
    model.opset_import[0].version = 99
    path.write_bytes(model.SerializeToString())
    text = refusal(path)
    assert text.startswith(f"{path}: cannot be loaded (") and "expected an ONNX model that onnxruntime" in text


def test_joints_are_compared_by_name(tmp_path):
    path = write_actor(tmp_path / "a.onnx")
    assert refusal(path, toy_robot(("hip", "knee", "toe", "waist"))) == (
        f"{path}: the joints of actor and robot 'toy' differ, got the robot lacks ankle; "
        "the actor lacks toe, waist, expected the same names; "
        "give actors of this robot; in simulation --start reference needs no stand actor"
    )
    assert load_actor(path, toy_robot(("ankle", "hip", "knee"))).spec.joint_names == JOINTS
    other = replace(ROBOT, name="pogo")
    assert refusal(path, other) == f"{path}: made for another robot, got 'toy', expected 'pogo'"


def test_the_motion_comes_from_the_file_or_from_the_caller(tmp_path):
    own = write_actor(tmp_path / "own.onnx")
    assert load_actor(own, ROBOT, toy_motion()).spec.motion.name == "bow"
    assert refusal(own, motion=toy_motion(name="kick", sha256="cd" * 32)) == (
        f"{own}: the motion given is not the one this actor tracks, got 'kick' (cdcdcdcdcdcd), "
        "expected 'bow' (abababababab); leave --motion out: the actor carries its own"
    )
    bare = write_actor(tmp_path / "bare.onnx", toy_spec(motion=None))
    assert refusal(bare) == f"{bare}: this actor carries no reference motion: give --motion"
    given = toy_motion(start_joint_pos_rad=np.array([3.0, 1.0, 2.0]))
    spec = load_actor(bare, toy_robot(("ankle", "hip", "knee")), given).spec
    assert spec.motion.start_joint_pos_rad.tolist() == [1.0, 2.0, 3.0]


def spec_with(*terms):
    return toy_spec(observations=(ObservationGroup("obs", terms),))


@pytest.mark.parametrize(
    ("spec", "graph", "text"),
    [
        (None, {"name": "actor_obs"}, "graph inputs differ from the spec, got actor_obs, expected the spec's "),
        (None, {"size": SIZE - 1}, f"graph input 'obs': wrong size, got [1, {SIZE - 1}], expected [1, {SIZE}] by the "),
        (None, {"joints": 4}, "graph output 'action': wrong size, got [1, 4], expected [1, 3] by the spec's joints"),
        (None, {"outputs": ("action", "value")}, "graph outputs differ from the spec, got action, value, expected one"),
        (
            None,
            {"dtype": TensorProto.DOUBLE},
            "graph input 'obs': wrong type, got tensor(double), expected tensor(float)",
        ),
        (None, {"params": [np.full_like(p, np.nan) for p in weights()]}, "the graph is broken, got a non-finite"),
        (spec_with(ObservationTerm("dof_pos", (0, 1, 2))), {}, f"graph input 'obs': wrong size, got [1, {SIZE}], "),
        (
            spec_with(ObservationTerm("odometry")),
            {},
            "observation group 'obs': unknown observation term, got odometry, expected one of actions, base_ang_vel,",
        ),
        (
            toy_spec(observations=(GROUP, replace(GROUP, name="map"))),
            {},
            "graph inputs differ from the spec, got obs, expected the spec's observation groups obs, map",
        ),
    ],
)
def test_graph_and_spec_must_agree(tmp_path, spec, graph, text):
    path = write_actor(tmp_path / "a.onnx", spec, **graph)
    assert refusal(path).startswith(f"{path}: {text}")


def test_a_free_dimension_is_settled_by_running(tmp_path):
    path = write_actor(tmp_path / "a.onnx", spec_with(ObservationTerm("dof_pos")))
    model = onnx.load(str(path))
    for value in (*model.graph.input, *model.graph.output):
        value.type.tensor_type.shape.dim[1].dim_param = "n"
        value.type.tensor_type.shape.dim[0].dim_param = "batch"
    onnx.save(model, str(path))
    assert refusal(path).startswith(f"{path}: the graph does not run (")


def test_damaged_metadata_is_refused_at_load(tmp_path):
    path = write_actor(tmp_path / "a.onnx")
    set_metadata(path, "motion_npz", "AAAA")
    assert refusal(path).startswith(f"{path}: motion_npz: the embedded motion is damaged")
    set_metadata(path, "actor_spec", spec_to_json(toy_spec()).replace("150.0", "-150.0"))
    assert refusal(path) == f"{path}: kp: not usable, got knee -150.0, expected 0 or more"
