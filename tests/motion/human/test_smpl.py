"""SMPL parameters: made-up people come back; what single rotations mean; what is said and what is refused."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.errors import InputError
from motion.frames import MAX_FRAMES
from motion.human.motion import JOINTS, HumanMotion
from motion.human.placing import placed
from motion.human.skeleton import MEAN_SKELETON
from motion.human.smpl import AMASS_FIELDS, read_amass, read_gvhmr, smpl_motion
from motion.importers.torch_file import read_torch
from motion.npz import read_npz
from tests.motion.human.people import Person, person, standing
from tests.motion.human.smpl_files import amass, gvhmr_table, parameters, torch_bytes


def from_amass(content: bytes, fps: float | None = None, up: str | None = None) -> HumanMotion:
    parameters = read_amass(read_npz(content, "a.npz", AMASS_FIELDS), "a.npz", fps)
    return placed(smpl_motion(parameters, None), up, "a.npz", "a.npz")


def from_gvhmr(table: dict, fps: float | None = None, up: str | None = None) -> HumanMotion:
    content = read_torch(torch_bytes({"smpl_params_global": table, "K": np.eye(3, dtype="<f4")}), "a.pt")
    return placed(smpl_motion(read_gvhmr(content, "a.pt", fps), None), up, "a.pt", "a.pt")


def assert_is(m: HumanMotion, who: Person, tolerance: float) -> None:
    """`m` is `who`, up to the height."""
    places = who.places()
    shift = m.pos_w - places
    np.testing.assert_allclose(shift, np.broadcast_to(shift[:1, :1] * [0, 0, 1], shift.shape), atol=tolerance)
    true = np.array([[turn.as_quat() for turn in turns] for turns in who.segments()])[..., [3, 0, 1, 2]]
    np.testing.assert_allclose(np.abs((m.quat_wxyz * true).sum(axis=-1)), 1.0, atol=tolerance)


@pytest.mark.parametrize("width", [156, 165, 72])
def test_amass(width):
    m = from_amass(amass(person(), width))
    assert_is(m, person(), 1e-9)
    assert m.fps == 120.0 and m.source == "a.npz" and "120 frames per second, as the file states." in m.notes
    assert any("Up is the axis z" in note for note in m.notes)
    assert any("No body model files" in note and "mean SMPL skeleton" in note for note in m.notes)


def test_gvhmr():
    m = from_gvhmr(gvhmr_table(person()))
    assert_is(m, person(), 1e-6)
    assert m.fps == 30.0 and any("30 frames per second assumed" in note for note in m.notes)
    assert any("Up is the axis y" in note for note in m.notes)
    assert from_gvhmr(gvhmr_table(person()), fps=25.0).fps == 25.0


def test_single_rotations():
    """In SMPL's axes: x left, y up, z forward. Identity is the T-pose; then a turn to the left, and a left forearm that
    is bent forward; in a world with z up the body is rolled up about x and looks along -y."""
    table = gvhmr_table(standing(4))
    assert np.abs(table["global_orient"]).max() == 0.0
    m = from_gvhmr(table)
    np.testing.assert_allclose(m.quat_wxyz[..., 0], 1.0, atol=1e-9)
    assert m.pos_w[0, 0, 2] == pytest.approx(0.938, abs=1e-3) and np.abs(m.sole_w[..., 2]).max() < 1e-6
    table["global_orient"][:] = [0.0, np.pi / 2, 0.0]
    elbow = 3 * (JOINTS.index("left_elbow") - 1)
    table["body_pose"][:, elbow : elbow + 3] = [0.0, -np.pi / 2, 0.0]
    m = from_gvhmr(table)
    shoulders = m.pos_w[0, JOINTS.index("left_shoulder")] - m.pos_w[0, JOINTS.index("right_shoulder")]
    np.testing.assert_allclose(shoulders / np.linalg.norm(shoulders), [-1.0, 0.0, 0.0], atol=1e-6)
    forearm = m.pos_w[0, JOINTS.index("left_wrist")] - m.pos_w[0, JOINTS.index("left_elbow")]
    np.testing.assert_allclose(forearm / np.linalg.norm(forearm), [0.0, 1.0, 0.0], atol=0.05)
    poses = np.zeros((3, 156))
    poses[:, 0] = np.pi / 2
    upright = from_amass(amass(standing(3), poses=poses, trans=np.zeros((3, 3))))
    toes = upright.pos_w[0, JOINTS.index("left_foot")] - upright.pos_w[0, JOINTS.index("left_ankle")]
    np.testing.assert_allclose(toes / np.linalg.norm(toes), [0.19, -0.9, -0.39], atol=0.02)


def test_rates_and_texts_as_they_are_stored():
    other_name = {"mocap_framerate": None, "mocap_frame_rate": np.array([60])}
    for changes in (other_name, {"mocap_framerate": np.float32(60.0)}):
        assert from_amass(amass(standing(), gender=np.array(b"female"), **changes)).fps == 60.0
    m = from_amass(amass(standing(), 165, surface_model_type=np.array("smplx")), fps=100.0)
    assert m.fps == 100.0 and m.notes[0] == "Read as smplx parameters of AMASS files."
    locked = amass(person(), 165, surface_model_type=np.array("smplx_locked_head"))
    assert_is(from_amass(locked), person(), 1e-9)
    assert from_amass(locked).notes[0] == m.notes[0]
    with pytest.raises(InputError, match=r"a\.npz: frame rate not stated; give it: --fps F"):
        from_amass(amass(standing(), mocap_framerate=None))


def test_a_world_with_y_up_is_found():
    """An AMASS-like file of somebody who stands in a world with y up, its ground at zero."""
    poses, trans = parameters(person(), "smplh", Rotation.from_matrix([[0, 1, 0], [0, 0, 1], [1, 0, 0]]))
    m = from_amass(amass(person(), poses=np.pad(poses, ((0, 0), (0, 90))), trans=np.add(trans, [0.0, 0.0, 2.0])))
    assert any(note.startswith("Up is the axis y, not z as in AMASS files") for note in m.notes)
    assert 1.2 < np.ptp(m.pos_w[..., 2]) < 1.8


def with_value(array: np.ndarray, value: float) -> np.ndarray:
    array = array.copy()
    array[2, 1] = value
    return array


POSES, TRANS = np.zeros((6, 156)), np.zeros((6, 3))
WRONG = {
    "one frame": ({"poses": POSES[:1], "trans": TRANS[:1]}, r"a\.npz: poses: too few frames, got 1"),
    "no frame": ({"poses": POSES[:0], "trans": TRANS[:0]}, r"a\.npz: poses: too few frames, got 0"),
    "too many": ({"poses": np.zeros((MAX_FRAMES + 1, 66), "i1")}, rf"a\.npz: poses: too long, got {MAX_FRAMES + 1}"),
    "narrow": ({"poses": POSES[:, :63]}, r"a\.npz: poses: wrong shape, got \(6, 63\)"),
    "not threes": ({"poses": POSES[:, :155]}, r"a\.npz: poses: wrong shape"),
    "wide": ({"poses": np.zeros((6, 900))}, r"a\.npz: poses: wrong shape or type"),
    "three axes": ({"poses": np.zeros((6, 52, 3))}, r"a\.npz: poses: wrong shape or type, got shape \(6, 52, 3\)"),
    "text": ({"poses": np.full((6, 156), "x")}, r"a\.npz: poses: wrong shape or type"),
    "frames differ": ({"trans": TRANS[:5]}, r"a\.npz: trans: wrong shape, got \(5, 3\), expected \(6, 3\)"),
    "flat": ({"trans": TRANS[:, :2]}, r"a\.npz: trans: wrong shape"),
    "nan": ({"poses": with_value(POSES, np.nan)}, r"a\.npz: poses: frame 2: not finite"),
    "infinite": ({"trans": with_value(TRANS, np.inf)}, r"a\.npz: trans: frame 2: not finite"),
    "degrees": ({"poses": with_value(POSES, 90.0)}, r"a\.npz: poses: frame 2: out of range, got 90 at pelvis.*degrees"),
    "enormous": ({"poses": with_value(POSES, 1e300)}, r"a\.npz: poses: frame 2: out of range"),
    "millimetres": ({"trans": np.add(TRANS, [0.0, 0.0, 1500.0])}, r"a\.npz: frame 0: too far away.*is the unit right"),
    "centimetres": ({"trans": np.add(TRANS, [0.0, 0.0, 115.0])}, r"a\.npz: far from the ground, got .*is the unit"),
    "cm, walking": ({"trans": np.arange(6.0)[:, None] * [1.1, 0, 0]}, r"a\.npz: the pelvis is too fast, got 132 m/s"),
    "rate 0": ({"mocap_framerate": np.array(0.0)}, r"a\.npz: frame rate: out of range, got 0, .*--fps F"),
    "rate nan": ({"mocap_framerate": np.array(np.nan)}, r"a\.npz: frame rate: out of range, got nan"),
    "rates": ({"mocap_framerate": np.zeros(3)}, r"a\.npz: mocap_framerate: not one number"),
    "rate text": ({"mocap_framerate": np.array("30")}, r"a\.npz: mocap_framerate: not one number"),
    "betas": ({"betas": np.full(10, np.nan)}, r"a\.npz: betas: not finite"),
    "many betas": ({"betas": np.zeros((2, 2, 2))}, r"a\.npz: betas: wrong shape"),
}


@pytest.mark.parametrize(("changes", "message"), WRONG.values(), ids=WRONG)
def test_wrong_amass_files_are_one_error(changes, message):
    with pytest.raises(InputError, match=f"^{message}"):
        from_amass(amass(standing(6), **changes), up="z")


WRONG_TABLES = {
    "no body_pose": (lambda t: t.pop("body_pose"), "no SMPL parameters"),
    "no transl": (lambda t: t.pop("transl"), r"smpl_params_global: transl: wrong shape or type, got nothing"),
    "frames": (lambda t: t.update(global_orient=t["global_orient"][:2]), r"global_orient: wrong shape, got \(2, 3\)"),
    "matrices": (lambda t: t.update(global_orient=np.zeros((6, 3, 3), "<f4")), "global_orient: wrong shape or type"),
    "nan": (lambda t: t["body_pose"].__setitem__((1, 5), np.nan), "body_pose: frame 1: not finite"),
    "a number": (lambda t: t.update(transl=3), "transl: wrong shape or type"),
}


@pytest.mark.parametrize(("change", "message"), WRONG_TABLES.values(), ids=WRONG_TABLES)
def test_wrong_gvhmr_results_are_one_error(change, message):
    table = gvhmr_table(standing(6))
    change(table)
    with pytest.raises(InputError, match=rf"^a\.pt: .*{message}"):
        from_gvhmr(table)


@pytest.mark.parametrize("content", [[1, 2], {"a": 1}, "text", None, {"smpl_params_global": 5}])
def test_other_torch_files(content):
    with pytest.raises(InputError, match=r"^a\.pt: no SMPL parameters"):
        read_gvhmr(content, "a.pt", None)


class _Array(np.ndarray):
    """What a body model holds: like torch's tensors, as far as they are asked."""

    def detach(self):
        return self

    cpu = detach

    def numpy(self):
        return np.asarray(self)


def test_with_body_models(tmp_path, monkeypatch):
    """A package smplx whose body is the mean skeleton with legs 10 % longer for a beta of 1; a vertex at each joint and
    one 9 cm under the left ankle."""
    joints = MEAN_SKELETON.t_pose_m()
    longer = np.zeros((23, 3, 10))
    for side in ("left", "right"):
        hip, knee, ankle, foot = (JOINTS.index(f"{side}_{name}") for name in ("hip", "knee", "ankle", "foot"))
        for i in (knee, ankle):
            longer[i, :, 0] = 0.1 * (joints[i] - joints[hip])
        longer[foot] = longer[ankle]
    under_ankle = joints[JOINTS.index("left_ankle")] - [0, 0, 0.09]
    longer[22] = longer[JOINTS.index("left_ankle")]
    vertices = np.add([*joints, under_ankle], [0.5, 0.6, 0.7])
    to_smpl = Rotation.from_matrix([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    layer = SimpleNamespace(
        v_template=to_smpl.apply(vertices).view(_Array),
        shapedirs=np.einsum("ij,vjb->vib", to_smpl.as_matrix(), longer).view(_Array),
        J_regressor=np.eye(22, 23).view(_Array),
    )
    calls = []
    fake = SimpleNamespace(create=lambda folder, **options: calls.append((folder, options)) or layer)
    monkeypatch.setitem(sys.modules, "smplx", fake)
    parameters = read_gvhmr({**gvhmr_table(standing()), "betas": np.tile([1.0] + [0.0] * 9, (4, 1))}, "a.pt", None)
    m = placed(smpl_motion(parameters, tmp_path), None, "a.pt", "a.pt")
    assert calls == [(str(tmp_path), {"model_type": "smplx", "gender": "neutral", "use_pca": False})]
    thigh = np.linalg.norm(m.pos_w[0, JOINTS.index("left_knee")] - m.pos_w[0, JOINTS.index("left_hip")])
    assert thigh == pytest.approx(1.1 * np.linalg.norm(MEAN_SKELETON.offset_m[JOINTS.index("left_knee")]), rel=1e-6)
    assert m.pos_w[0, JOINTS.index("left_ankle"), 2] == pytest.approx(0.09, abs=1e-6)
    assert "The body is the licensed smplx model, neutral, with 10 shape numbers of the file." in m.notes


def test_body_models_that_cannot_be_had(tmp_path, monkeypatch):
    parameters = read_gvhmr(gvhmr_table(standing()), "a.pt", None)
    with pytest.raises(InputError, match="--body-models: no such folder"):
        smpl_motion(parameters, tmp_path / "nowhere")
    monkeypatch.setitem(sys.modules, "smplx", None)
    with pytest.raises(InputError, match="the package smplx is not installed; install it"):
        smpl_motion(parameters, tmp_path)
    broken = SimpleNamespace(create=lambda *_, **__: (_ for _ in ()).throw(AssertionError("Path does not exist")))
    monkeypatch.setitem(sys.modules, "smplx", broken)
    with pytest.raises(InputError, match="smplx cannot load smplx, neutral, got AssertionError: Path does not exist"):
        smpl_motion(parameters, tmp_path)
