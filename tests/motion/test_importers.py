"""Other people's formats, from small files written here and, where present, from the real ones."""

import pickle

import numpy as np
import pytest

from core.errors import InputError
from motion.contact import contact_of
from motion.feet import lowest_sole_m
from motion.importers.csv_joints import read_csv_joints
from motion.importers.g1_joints import JOINTS_29 as CSV_JOINTS
from motion.importers.pbhc_pkl import JOINT_NAMES as PBHC_JOINTS
from motion.importers.pbhc_pkl import read_pbhc
from motion.importers.pickle_data import read_data_pickle
from motion.reference import joint_columns
from tests.shared_data import SHARED, needs_shared_data

PBHC_FILES = {"Horse-stance_pose.pkl": 210, "Charleston_dance.pkl": 610, "Roundhouse_kick.pkl": 158}
CSV_FILES = {"M_Move19.csv": 1012, "M_Move3.csv": 1918, "M_Move10.csv": 1832, "J_Dance0_StepTouch.csv": 1949}


@pytest.fixture
def motion() -> dict:
    """One PBHC motion of four frames; root turned by 90 degrees about z (xyzw)."""
    half = np.sqrt(0.5)
    return {
        "root_trans_offset": np.tile([1.0, 2.0, 0.8], (4, 1)).astype(np.float32),
        "root_rot": np.tile([0.0, 0.0, half, half], (4, 1)).astype(np.float32),
        "dof": np.tile(np.arange(23) / 100.0, (4, 1)).astype(np.float32),
        "contact_mask": np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0], [1.0, 1.0]]),
        "fps": 30,
    }


def test_pbhc_fields(motion):
    clip = read_pbhc(pickle.dumps({"a/secret/place": motion}), "folder/kick.pkl")
    assert clip.fps == 30.0 and clip.joint_names == PBHC_JOINTS
    np.testing.assert_allclose(clip.root_quat_wxyz[0], [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], atol=1e-7)
    np.testing.assert_allclose(clip.joint_pos_rad[2], np.arange(23) / 100.0, atol=1e-7)
    np.testing.assert_array_equal(clip.contact, motion["contact_mask"])
    assert clip.source == "kick.pkl"
    assert "secret" not in clip.source + clip.license + clip.created_by


def test_pbhc_without_the_outer_key(motion):
    assert read_pbhc(pickle.dumps(motion), "a.pkl").num_frames == 4


WRONG_PBHC = {
    "missing": (lambda m: m.pop("contact_mask"), "missing fields, got no contact_mask"),
    "no fps": (lambda m: m.pop("fps"), "missing fields, got no fps"),
    "joints": (lambda m: m.update(dof=m["dof"][:, :22]), r"dof: wrong shape or type, got \(4, 22\)"),
    "list": (lambda m: m.update(root_rot=[1, 2]), "root_rot: wrong shape or type, got list"),
    "frames": (lambda m: m.update(dof=m["dof"][:3]), "numbers of frames differ"),
    "nan": (lambda m: m["dof"].__setitem__((2, 5), np.nan), "joint_pos_rad: frame 2: not finite"),
    "quaternion": (lambda m: m.update(root_rot=2 * m["root_rot"]), "root_quat_wxyz: frame 0"),
    "fps zero": (lambda m: m.update(fps=0), "fps: out of range"),
    "fps text": (lambda m: m.update(fps="30"), "fps: wrong type"),
    "contact": (lambda m: m.update(contact_mask=3.0 * m["contact_mask"]), "contact: frame 0"),
}


@pytest.mark.parametrize(("change", "message"), WRONG_PBHC.values(), ids=WRONG_PBHC)
def test_pbhc_errors_name_file_and_field(motion, change, message):
    change(motion)
    with pytest.raises(InputError, match=rf"^a\.pkl: .*{message}|^a\.pkl: {message}"):
        read_pbhc(pickle.dumps({"key": motion}), "a.pkl")


@pytest.mark.parametrize("content", [{"a": 1, "b": 2}, [1, 2], 5, {}, {"a": 3}])
def test_pickles_without_a_motion(content):
    with pytest.raises(InputError, match="no PBHC motion"):
        read_pbhc(pickle.dumps(content), "a.pkl")


@pytest.mark.parametrize("padding", [None, 0, 7])
def test_joblib_layout(padding):
    """An array lies raw behind the wrapper's state, after the padding's length (joblib >= 1.2) or at once."""
    array = np.arange(6, dtype="<f4").reshape(2, 3)
    alignment = b"N" if padding is None else b"K\x10"
    content = (
        b"\x80\x04}\x8c\x01x\x8c\x13joblib.numpy_pickle\x8c\x11NumpyArrayWrapper\x93)\x81}("
        b"\x8c\x08subclass\x8c\x05numpy\x8c\x07ndarray\x93\x8c\x05shapeK\x02K\x03\x86\x8c\x05order\x8c\x01C"
        b"\x8c\x05dtype\x8c\x05numpy\x8c\x05dtype\x93\x8c\x02f4\x89\x88\x87R(K\x03\x8c\x01<NNNJ\xff\xff\xff\xff"
        b"J\xff\xff\xff\xffK\x00tb\x8c\x1bnumpy_array_alignment_bytes" + alignment + b"ub"
    )
    content += b"" if padding is None else bytes([padding]) + b"\xff" * padding
    content += array.tobytes() + b"s."
    np.testing.assert_array_equal(read_data_pickle(content, "x")["x"], array)
    with pytest.raises(InputError, match="damaged pickle"):
        read_data_pickle(content[:-12], "x")


@needs_shared_data
@pytest.mark.parametrize(("name", "frames"), PBHC_FILES.items())
def test_released_motions(robot, name, frames):
    """They load, and their mask fits where forward kinematics puts the feet: left first."""
    clip = read_pbhc((SHARED / "pbhc" / name).read_bytes(), name)
    assert (clip.num_frames, clip.fps, clip.source) == (frames, 30.0, name)
    assert set(np.unique(clip.contact)) == {0.0, 0.5, 1.0}
    joints = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    assert np.all((joints >= robot.pos_lower_rad - 1e-3) & (joints <= robot.pos_upper_rad + 1e-3))
    bodies = robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, joints)
    feet = bodies.pos_w[:, robot.tracked_index(robot.feet)]
    own = contact_of((clip, robot))
    assert (np.abs(own - clip.contact) <= 0.5).mean() > 0.92
    assert (np.abs(own - clip.contact[:, ::-1]) <= 0.5).mean() < (np.abs(own - clip.contact) <= 0.5).mean() - 0.08
    off = clip.contact == 0.0
    assert feet[..., 2][off].mean() > feet[..., 2][clip.contact == 1.0].mean() + 0.02


def csv_rows(num_frames: int = 4) -> np.ndarray:
    rows = np.zeros((num_frames, 36))
    rows[:, 2] = 0.9
    rows[:, 3:7] = [0.0, 0.0, 0.6, 0.8]
    rows[:, 7:] = np.arange(29) / 100.0
    return rows


def csv_bytes(rows: np.ndarray) -> bytes:
    return "\n".join(",".join(f"{x:.6f}" for x in row) for row in rows).encode() + b"\n"


def test_csv_fields(robot):
    clip = read_csv_joints(csv_bytes(csv_rows()), "folder/walk.csv", robot)
    assert clip.fps == 60.0 and clip.num_joints == 23 and clip.source == "walk.csv"
    np.testing.assert_allclose(clip.root_quat_wxyz[0], [0.8, 0.0, 0.0, 0.6])
    for name, value in zip(clip.joint_names, clip.joint_pos_rad[1], strict=True):
        assert value == pytest.approx(CSV_JOINTS.index(name) / 100.0)
    assert not [name for name in clip.joint_names if "wrist" in name]
    np.testing.assert_array_equal(clip.contact, 1.0)


def test_csv_of_23_joints(robot):
    """The same joints without wrists: the same clip."""
    wrists = [7 + i for i, name in enumerate(CSV_JOINTS) if "wrist" in name]
    short, long = (
        read_csv_joints(csv_bytes(rows), "a.csv", robot, 30.0)
        for rows in (np.delete(csv_rows(), wrists, axis=1), csv_rows())
    )
    assert short.sha256 == long.sha256 and short.joint_names == PBHC_JOINTS
    assert short.created_by == "kata, from a 23-joint CSV"


def test_csv_rate_that_is_assumed_is_said(robot):
    assert "60 frames per second assumed" in read_csv_joints(csv_bytes(csv_rows()), "a.csv", robot).created_by


def test_csv_in_other_units(robot):
    rows = csv_rows()
    rows[:, 2] = 90.0
    with pytest.raises(InputError, match=r"a\.csv: far from the ground, got 89\.\d+ m, .*must be in metres"):
        read_csv_joints(csv_bytes(rows), "a.csv", robot)
    rows = csv_rows()
    rows[:, 7:] = np.degrees(rows[:, 7:] * 10.0)
    with pytest.raises(InputError, match=r"a\.csv: joint_pos_rad: frame 0: out of range"):
        read_csv_joints(csv_bytes(rows), "a.csv", robot)


def test_csv_too_long(robot):
    with pytest.raises(InputError, match=r"a\.csv: too long, got 100001 frames"):
        read_csv_joints(b"\n" * 100_000 + b"1", "a.csv", robot)


def test_csv_stands_on_the_ground(robot):
    for height in (0.2, 0.9, 3.0):
        rows = csv_rows()
        rows[:, 2], rows[:, 7:] = height, 0.0
        rows[2, 2] += 0.05
        clip = read_csv_joints(csv_bytes(rows), "a.csv", robot, fps=30.0)
        bodies = robot.kinematics.forward(
            clip.root_pos_w, clip.root_quat_wxyz, clip.joint_pos_rad[:, joint_columns(clip, robot)]
        )
        lowest = lowest_sole_m(robot, bodies.pos_w, bodies.quat_wxyz)
        np.testing.assert_allclose(lowest, [0.0, 0.0, 0.05, 0.0], atol=1e-6)


def test_csv_errors_name_line_and_column(robot):
    lines = csv_bytes(csv_rows()).decode().splitlines()
    short = "\n".join([*lines[:2], lines[2].rpartition(",")[0]]).encode()
    word = "\n".join([lines[0], lines[1].replace("0.600000", "ohno"), lines[2]]).encode()
    header = ("x," * 35 + "x\n" + "\n".join(lines)).encode()
    infinite = "\n".join([lines[0], lines[1].replace("0.900000", "nan")]).encode()
    for content, message in {
        short: r"a\.csv: line 3: wrong number of columns, got 35, expected 36",
        word: r"a\.csv: line 2, column 6: not a number, got 'ohno'",
        header: r"a\.csv: line 1, column 1: not a number, got 'x'; the format has no header line",
        infinite: r"a\.csv: root_pos_w: frame 1: not finite",
        b"\xff\xfe\x00": r"a\.csv: is not text",
        lines[0].encode(): "too few frames",
        b"\n\n": "too few frames",
    }.items():
        with pytest.raises(InputError, match=message):
            read_csv_joints(content, "a.csv", robot)
    with pytest.raises(InputError, match=r"a\.csv: fps: out of range"):
        read_csv_joints(csv_bytes(csv_rows()), "a.csv", robot, fps=0.0)


@needs_shared_data
def test_csv_joint_order_is_the_makers():
    urdf = (SHARED / "robot" / "29dof_official.urdf").read_text()
    names = [part.split('"')[1] for part in urdf.split("<joint name=")[1:] if 'type="revolute"' in part.split(">")[0]]
    assert tuple(names) == CSV_JOINTS


@needs_shared_data
@pytest.mark.parametrize(("name", "frames"), CSV_FILES.items())
def test_mocap_files(robot, name, frames):
    clip = read_csv_joints((SHARED / "g1moves" / name).read_bytes(), name, robot)
    assert (clip.num_frames, clip.fps) == (frames, 60.0)
    joints = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    bodies = robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, joints)
    lowest = lowest_sole_m(robot, bodies.pos_w, bodies.quat_wxyz)
    assert -0.035 < lowest.min() < -0.01 and abs(np.median(lowest)) < 0.02
    assert 0.75 < clip.contact.mean() <= 1.0
