"""BVH files of made-up people in every known skeleton come back as the motion they were made of."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.errors import InputError
from motion.human.bvh import UNITS_M, bvh_motion
from motion.human.motion import JOINTS, HumanMotion
from motion.human.placing import placed
from motion.human.skeleton import MEAN_SKELETON
from motion.human.skeleton_map import SKELETONS, load_skeleton_map
from tests.motion.human.people import Y_UP, Z_UP, Person, Rig, bvh_text, person, standing
from tests.shared_data import SHARED, needs_shared_data

pytestmark = pytest.mark.filterwarnings("ignore:Gimbal lock")  # the T-pose of LAFAN1 is one, for its collars
LIMBS = [(f"{s}_{a}", f"{s}_{b}") for s in ("left", "right")
         for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))]  # fmt: skip
UP, FORWARD, LEFT = np.eye(3)[[2, 0, 1]]


def names_of(skeleton: str, prefix: str = "") -> dict[str, str]:
    return {ours: prefix + name for ours, name in load_skeleton_map(SKELETONS / f"{skeleton}.yaml").joints.items()}


def axes(x: np.ndarray, y: np.ndarray) -> Rotation:
    """A joint's own axes in the T-pose (in our axes), for a file that faces z with y up."""
    return Rotation.from_matrix(np.stack([x, y, np.cross(x, y)], axis=1)) * Y_UP


def lafan() -> Rig:
    """Bones along their own x axes; spine y forward; legs y forward; arms y backward; feet down to flat toes."""
    slope = np.radians(24.5)
    foot = axes(np.cos(slope) * FORWARD - np.sin(slope) * UP, np.cos(slope) * UP + np.sin(slope) * FORWARD)
    level = axes(np.array([0.99863, 0.0, -0.05234]), np.array([0.05234, 0.0, 0.99863]))
    frames = dict.fromkeys(("pelvis", "spine1", "spine2", "spine3", "neck", "head"), axes(UP, FORWARD))
    for side, out in (("left", LEFT), ("right", -LEFT)):
        frames |= dict.fromkeys((f"{side}_hip", f"{side}_knee"), axes(-UP, FORWARD))
        frames |= dict.fromkeys((f"{side}_{j}" for j in ("collar", "shoulder", "elbow", "wrist")), axes(out, -FORWARD))
        frames |= {f"{side}_ankle": foot, f"{side}_foot": level}
    return Rig(names_of("lafan1"), frames)


def cmu() -> Rig:
    """Legs, feet with them, spread by 20 degrees in the zero pose; own unit; 120 frames per second."""
    frames = {}
    for side, sign in (("left", -1.0), ("right", 1.0)):
        spread = Rotation.from_euler("x", 20.0 * sign, degrees=True)
        frames |= dict.fromkeys((f"{side}_{joint}" for joint in ("hip", "knee", "ankle", "foot")), spread)
    return Rig(names_of("cmu"), frames, unit_m=0.0254 / 0.45, frame_time=".0083333")


def mocapbank() -> Rig:
    """Arms down in the zero pose."""
    frames = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        down = Rotation.from_euler("x", 88.0 * sign, degrees=True)
        frames |= dict.fromkeys((f"{side}_{joint}" for joint in ("shoulder", "elbow", "wrist")), down)
    return Rig(names_of("mocapbank"), frames, order=("Zrotation", "Xrotation", "Yrotation"))


RIGS = {
    "lafan1": lafan,
    "cmu": cmu,
    "mocapbank": mocapbank,
    "mixamo": lambda: Rig(names_of("mixamo", "mixamorig:"), unit_m=0.01),
    "mixamo, no prefix, z up, metres": lambda: Rig(names_of("mixamo"), axes=Z_UP, unit_m=1.0),
}


def read(text: str, *, fps: float | None = None, unit: str | None = None, up: str | None = None,
         skeleton: Path | None = None) -> HumanMotion:  # fmt: skip
    recording = bvh_motion(text.encode(), "a.bvh", fps=fps, unit=unit, skeleton=skeleton)
    return placed(recording, up, "a.bvh", "a.bvh")


def angles_deg(m: HumanMotion, who: Person) -> np.ndarray:
    """Angle (N,22) between every segment that was read and the true one."""
    true = np.array([[turn.as_quat() for turn in turns] for turns in who.segments()])[..., [3, 0, 1, 2]]
    return np.degrees(2.0 * np.arccos(np.clip(np.abs((m.quat_wxyz * true).sum(axis=-1)), 0.0, 1.0)))


@pytest.mark.parametrize("make", RIGS.values(), ids=RIGS)
def test_people_come_back(make):
    rig = make()
    who = person(stiff=set(JOINTS) - set(rig.names))
    m = read(bvh_text(who, rig))
    known = [i for i, name in enumerate(JOINTS) if name in rig.names and "foot" not in name]
    true = who.places()
    np.testing.assert_allclose((m.pos_w - m.pos_w[:, :1])[:, known], (true - true[:, :1])[:, known], atol=2e-5)
    np.testing.assert_allclose(m.pos_w[:, 0, :2], true[:, 0, :2], atol=2e-5)
    off = angles_deg(m, who)
    assert off[:, known].max() < 0.05


@pytest.mark.parametrize("make", RIGS.values(), ids=RIGS)
def test_segments_point_where_their_bones_do(make):
    m = read(bvh_text(person(seed=3), make()))
    assert_bones_follow(m, 0.05)


def assert_bones_follow(m: HumanMotion, limit_deg: float) -> None:
    for joint, child in LIMBS:
        i, k = JOINTS.index(joint), JOINTS.index(child)
        bone = m.pos_w[:, k] - m.pos_w[:, i]
        turned = Rotation.from_quat(m.quat_wxyz[:, i][:, [1, 2, 3, 0]]).apply(MEAN_SKELETON.offset_m[k].copy())
        cosine = (bone * turned).sum(axis=1) / np.linalg.norm(bone, axis=1) / np.linalg.norm(turned, axis=1)
        assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < limit_deg, joint


@pytest.mark.parametrize("make", RIGS.values(), ids=RIGS)
def test_soles_stand_on_the_ground(make):
    m = read(bvh_text(standing(), make()))
    np.testing.assert_allclose(m.sole_w[..., 2], 0.0, atol=1e-5)
    assert angles_deg(m, standing()).max() < 0.1
    ankles = m.pos_w[:, [JOINTS.index("left_ankle"), JOINTS.index("right_ankle")]]
    heel, toe = m.sole_w[:, :, 0] - ankles, m.sole_w[:, :, 3] - ankles
    np.testing.assert_allclose(heel[..., 0], -0.055, atol=1e-3)
    np.testing.assert_allclose(toe[..., 0], 0.190, atol=1e-3)
    assert (m.sole_w[:, 0, 2, 1] > m.sole_w[:, 0, 1, 1]).all() and (m.sole_w[:, 1, 2, 1] < m.sole_w[:, 1, 1, 1]).all()


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_channels_in_any_order(order):
    rig = replace(RIGS["mixamo"](), order=tuple(f"{axis}rotation" for axis in order))
    assert angles_deg(read(bvh_text(person(), rig)), person()).max() < 0.05


@pytest.mark.parametrize(("unit", "metres"), UNITS_M.items())
def test_units_are_detected_and_said(unit, metres):
    m = read(bvh_text(standing(), replace(RIGS["mixamo"](), unit_m=metres)))
    assert any(note.startswith(f"The unit is {unit}") for note in m.notes)
    assert m.pos_w[0, 0, 2] == pytest.approx(0.938, abs=3e-3)


def test_a_size_that_no_unit_explains_is_asked_for():
    small = bvh_text(standing(), replace(RIGS["mixamo"](), scale=0.28))
    with pytest.raises(InputError, match=r"a\.bvh: unclear unit, got legs of 21\.\d+ units.*say it: --unit UNIT"):
        read(small)
    assert read(small, unit="cm").pos_w[0, 0, 2] == pytest.approx(0.263, abs=0.02)
    with pytest.raises(InputError, match=r"wrong unit mm, got 0\.021\d+ m"):
        read(small, unit="mm")
    with pytest.raises(InputError, match="unknown unit, got furlong, expected one of m, cm"):
        read(small, unit="furlong")


RATES = {"0.033333": 30.0, "0.0333333": 30.0, "0.033": 30.0, "0.008333": 120.0, ".0083333": 120.0, "0.04167": 24.0,
         "0.0166667": 60.0, "0.0333667": 29.97, "0.02": 50.0, "1.0": 1.0, "1e-2": 100.0}  # fmt: skip


@pytest.mark.parametrize(("text", "fps"), RATES.items())
def test_frame_times_are_rounded_rates(text, fps):
    m = read(bvh_text(standing(), replace(RIGS["mixamo"](), frame_time=text)))
    assert m.fps == pytest.approx(fps, rel=1e-5) and any(note.startswith(f"{m.fps:g} frames") for note in m.notes)


@pytest.mark.parametrize("text", ["0", "0.0", "-0.03"])
def test_frame_time_zero(text):
    wrong = bvh_text(standing(), replace(RIGS["mixamo"](), frame_time=text))
    with pytest.raises(InputError, match=rf"a\.bvh: frame time is not positive, got {text} s; .*--fps F"):
        read(wrong)
    assert read(wrong, fps=60.0).fps == 60.0


@pytest.mark.parametrize(("text", "fps"), [("1e-9", None), ("1e9", None), ("0.03", 0.0), ("0.03", 1e6), ("0.03", -1.0)])
def test_absurd_rates(text, fps):
    with pytest.raises(InputError, match=r"out of range, got .*, expected 1 to 1000 frames per second"):
        read(bvh_text(standing(), replace(RIGS["mixamo"](), frame_time=text)), fps=fps)


def test_a_given_rate_counts_more_and_is_said():
    m = read(bvh_text(standing(), RIGS["cmu"]()), fps=60.0)
    assert m.fps == 60.0 and "60 frames per second, as given, though the file states 120." in m.notes


def test_up_follows_the_rest_pose_and_what_is_given():
    lying = standing()
    lying.local = [[Rotation.from_euler("y", 90, degrees=True), *turns[1:]] for turns in lying.local]
    lying.root = np.tile([0.0, 0.0, 0.15], (4, 1))
    text = bvh_text(lying, RIGS["mixamo"]())
    with pytest.raises(InputError, match=r"a\.bvh: unclear which way is up, got a body along the axis z .*--up=y"):
        read(text)
    m = read(text, up="y")
    assert np.abs(m.pos_w[0, :, 2] - m.pos_w[0, 0, 2]).max() < 0.3
    with pytest.raises(InputError, match="up: unknown axis, got w"):
        read(text, up="w")


def test_a_rest_pose_in_front_is_left_out():
    text = bvh_text(person(), RIGS["mixamo"]())
    head, _, frames = text.partition("Frame Time: 0.033333\n")
    lines = frames.splitlines()
    still = " ".join([*lines[0].split()[:3], *["0"] * 66])
    m = read(head.replace("Frames: 6", "Frames: 7") + "Frame Time: 0.033333\n" + "\n".join([still, *lines]))
    assert m.num_frames == 6 and any("rest pose put in front" in note for note in m.notes)


def test_a_joint_with_places_lies_where_they_say():
    """A shin 5 cm longer than its offset, by position channels."""
    text = bvh_text(standing(), RIGS["mixamo"]()).splitlines()
    at = text.index("JOINT mixamorig:LeftFoot")
    offset = [float(x) for x in text[at + 2].split()[1:]]
    text[at + 3] = text[at + 3].replace("CHANNELS 3", "CHANNELS 6 Xposition Yposition Zposition")
    column = 3 + 3 * sum(line.startswith(("ROOT", "JOINT")) for line in text[:at])
    first = next(i for i, line in enumerate(text) if line.startswith("Frame Time")) + 1
    for i in range(first, len(text)):
        values = text[i].split()
        values[column:column] = [f"{offset[0]}", f"{offset[1] - 5.0}", f"{offset[2]}"]
        text[i] = " ".join(values)
    m = read("\n".join(text))
    left, right = (m.pos_w[0, JOINTS.index(f"{side}_ankle"), 2] for side in ("left", "right"))
    assert left == pytest.approx(right - 0.05, abs=1e-4)
    squeezed = [line if i < first else " ".join([*line.split()[:column], "0", "0", "0", *line.split()[column + 3 :]])
                for i, line in enumerate(text)]  # fmt: skip
    with pytest.raises(InputError, match="offsets and position channels contradict each other, got legs of"):
        read("\n".join(squeezed))


MAPPING = """
joints: {pelvis: root, left_hip: a, left_knee: b, left_ankle: c, left_foot: c/end, right_hip: d, right_knee: e,
  right_ankle: f, right_foot: f/end, neck: n, left_shoulder: g, left_elbow: h, left_wrist: i, right_shoulder: j,
  right_elbow: k, right_wrist: l}
t_pose: {}
foot: {at: ball, above_sole_m: 0.018}
"""


def test_a_mapping_of_ones_own(tmp_path):
    (tmp_path / "mine.yaml").write_text(MAPPING)
    names = load_skeleton_map(tmp_path / "mine.yaml").joints
    who = person(stiff=set(JOINTS) - set(names))
    text = bvh_text(who, Rig(names))
    with pytest.raises(InputError, match=r"a\.bvh: unknown skeleton, got joints root, .*: --skeleton FILE"):
        read(text)
    m = read(text, skeleton=tmp_path / "mine.yaml")
    assert m.notes[0] == "Read as a BVH with the skeleton mine."
    legs = [JOINTS.index(name) for name in ("left_knee", "right_ankle", "neck", "left_wrist")]
    true = who.places()
    np.testing.assert_allclose((m.pos_w - m.pos_w[:, :1])[:, legs], (true - true[:, :1])[:, legs], atol=2e-5)
    spine = m.pos_w[:, [0, JOINTS.index("spine1"), JOINTS.index("spine3"), JOINTS.index("neck")]]
    assert (np.diff(np.linalg.norm(spine - spine[:, :1], axis=-1), axis=1) > 0.05).all()
    (tmp_path / "other.yaml").write_text(MAPPING.replace("neck: n", "neck: nothing"))
    with pytest.raises(InputError, match=r"a\.bvh: joints of the mapping are missing, got no nothing"):
        read(text, skeleton=tmp_path / "other.yaml")


def test_rest_poses_that_are_none():
    names = names_of("mixamo")
    swapped = {ours.replace("left", "x").replace("right", "left").replace("x", "right"): n for ours, n in names.items()}
    with pytest.raises(InputError, match=r"no T-pose, got 1[0-9]+ degrees off"):
        read(bvh_text(standing(), Rig(swapped, order=("Xrotation", "Yrotation", "Zrotation"))))
    with pytest.raises(InputError, match=r"left_ankle: no T-pose, got \d+ degrees off.*must stand flat-footed"):
        tiptoe = {f"{s}_ankle": Rotation.from_euler("y", -60, degrees=True) for s in ("left", "right")}
        read(bvh_text(standing(), Rig(names, tiptoe)))
    with pytest.raises(InputError, match=r"the body's up in the T-pose: no T-pose, got 4[0-9] degrees off.*t_pose"):
        read(bvh_text(standing(), Rig(names, axes=Y_UP * Rotation.from_euler("y", 45, degrees=True))))
    text = bvh_text(standing(), Rig(names)).splitlines()
    at = text.index("JOINT LeftForeArm")
    with pytest.raises(InputError, match="joints at one place, got left_shoulder and left_elbow"):
        read("\n".join([*text[: at + 2], "OFFSET 0 0 0", *text[at + 3 :]]))


@needs_shared_data
def test_the_mocapbank_file():
    """Kneeling down on the right knee and up again, in shoes; see the notes for what was detected."""
    content = (SHARED / "bvh" / "mocapbank.bvh").read_bytes()
    m = placed(bvh_motion(content, "m.bvh", fps=None, unit=None, skeleton=None), None, "m.bvh", "m.bvh")
    assert (m.num_frames, m.fps, m.source) == (455, 30.0, "m.bvh")
    assert m.notes[1:3] == ("30 frames per second, as the file states.",
                            "The unit is cm (0.01 m): only so do the legs, 0.873 m, fit a grown person.")  # fmt: skip
    assert any(note.startswith("Up is the axis y") for note in m.notes)
    assert_bones_follow(m, 0.01)
    pelvis, knee = m.pos_w[:, 0, 2], m.pos_w[:, JOINTS.index("right_knee"), 2]
    assert pelvis[0] == pytest.approx(0.936, abs=0.01) and pelvis[200:300].max() < 0.5 and knee[200:300].max() < 0.06
    assert np.abs(m.sole_w[[0, 70, 400, 454]][..., 2]).max() < 0.03
    down = Rotation.from_quat(m.quat_wxyz[0, [16, 17]][:, [1, 2, 3, 0]]).apply([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    assert (down[:, 2] < -0.8).all()
