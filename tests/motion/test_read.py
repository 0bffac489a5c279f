"""Any motion file: told by its content, read as what it is, refused in one line where it is none."""

import pickle
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from core.errors import InputError
from motion.clip import Clip, clip_to_bytes
from motion.formats import Format, format_of
from motion.human.motion import HumanMotion
from motion.human.skeleton_map import SKELETONS, load_skeleton_map
from motion.library import open_motion
from motion.read import read_motion
from tests.motion.human.people import Rig, bvh_text, person
from tests.motion.human.smpl_files import amass, gvhmr_table, torch_bytes
from tests.motion.robot_files import mjlab_arrays, npz_bytes
from tests.shared_data import SHARED, needs_shared_data

PNG = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + bytes(range(256))


@pytest.fixture(scope="session")
def files(robot) -> dict[Format, bytes]:
    """A small file of every format."""
    still = {
        "root_pos_w": np.tile([0.0, 0.0, 0.8], (4, 1)),
        "root_quat_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (4, 1)),
        "joint_pos_rad": np.tile(robot.default_pos_rad, (4, 1)),
        "contact": np.ones((4, 2)),
    }
    row = ",".join(["0", "0", "0.8", "0", "0", "0", "1", *["0.1"] * 29])
    pkl = {
        "root_trans_offset": still["root_pos_w"],
        "root_rot": np.tile([0.0, 0.0, 0.0, 1.0], (4, 1)),
        "dof": still["joint_pos_rad"],
        "contact_mask": still["contact"],
        "fps": 30,
    }
    mixamo = load_skeleton_map(SKELETONS / "mixamo.yaml").joints
    return {
        Format.CLIP: clip_to_bytes(Clip(fps=30.0, joint_names=robot.joint_names, **still)),
        Format.MJLAB: npz_bytes(mjlab_arrays(robot)),
        Format.PBHC: pickle.dumps({"key": pkl}),
        Format.CSV: "\n".join([row] * 4).encode(),
        Format.AMASS: amass(person(4)),
        Format.GVHMR: torch_bytes({"smpl_params_global": gvhmr_table(person(4)), "K_fullimg": np.eye(3, dtype="<f4")}),
        Format.BVH: bvh_text(person(4), Rig(mixamo)).encode(),
    }


TEXTS = (Format.CSV, Format.BVH)  # which are refused when they are called .npz


@pytest.mark.parametrize("kind", Format)
@pytest.mark.parametrize("name", ["a", "a.npz", "a.bin"])
def test_told_by_the_content(robot, files, tmp_path, kind, name):
    path = tmp_path / (name if kind not in TEXTS else name.replace("npz", "txt"))
    path.write_bytes(files[kind])
    assert format_of(files[kind], path) is kind
    motion = read_motion(path, robot=robot)
    human = kind in (Format.AMASS, Format.GVHMR, Format.BVH)
    assert isinstance(motion, HumanMotion if human else Clip) and motion.source in (path.name, "")
    if human:
        with pytest.raises(InputError, match=rf"{path.name}: is a human's motion, got {kind.value}, .*motion/process"):
            open_motion(path, robot)
    else:
        assert open_motion(path, robot).sha256 == motion.sha256


@pytest.mark.parametrize("kind", Format)
def test_a_given_rate_counts(robot, files, tmp_path, kind):
    (tmp_path / "a").write_bytes(files[kind])
    assert read_motion(tmp_path / "a", robot=robot, fps=40.0).fps == 40.0
    for fps in (0.0, -1.0, 1e9, float("nan")):
        with pytest.raises(InputError, match="out of range"):
            read_motion(tmp_path / "a", robot=robot, fps=fps)


@pytest.mark.parametrize(
    ("kind", "options", "unused"),
    [
        (Format.BVH, {"body_models": Path("none")}, "BVH has no use for --body-models"),
        (Format.AMASS, {"skeleton": Path("none.yaml"), "unit": "cm"}, "AMASS motion has no use for --skeleton, --unit"),
        (Format.CSV, {"up": "y"}, "CSV of robot joints has no use for --up"),
    ],
)
def test_an_option_for_which_the_format_has_no_use_is_refused(robot, files, tmp_path, kind, options, unused):
    (tmp_path / "a").write_bytes(files[kind])
    with pytest.raises(InputError, match=f"a: {unused}; leave it out"):
        read_motion(tmp_path / "a", robot=robot, **options)


OLD_TORCH = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03."
MISLABELLED = {
    **{"a.bvh": PNG, "b.bvh": b"\x93\xff\xfa", "c.bvh": b"1,2,3\n", "empty.bvh": b"", "clip.bvh": b"PK\x03\x04"},
    **{"a.npz": PNG, "b.npz": b"HIERARCHY\n", "empty.npz": b"", "short.npz": b"PK"},
    **{"a.pt": b"text", "empty.pt": b"", "old.pt": OLD_TORCH, "a.pkl": PNG, "b.pkl": b"HIERARCHY\n"},
    **{"a.csv": PNG, "b.csv": b"HIERARCHY\nROOT x", "c.csv": b"name,age\n", "empty.csv": b"", "blank.csv": b" \n\n"},
    **{"picture": PNG, "zeros": bytes(1000)},
}


@pytest.mark.parametrize(("name", "content"), MISLABELLED.items())
def test_mislabelled_files_are_one_error(robot, tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_motion(tmp_path / name, robot=robot)
    assert str(caught.value).startswith(str(tmp_path / name)) and "\n" not in str(caught.value)
    assert str(caught.value).count(name) == 1


def test_archives_that_hold_no_motion(robot, tmp_path):
    with zipfile.ZipFile(tmp_path / "a.docx", "w") as archive:
        archive.writestr("word/document.xml", "text")
    with pytest.raises(InputError, match=r"a\.docx: unknown archive, got word/document\.xml, expected kata clip"):
        read_motion(tmp_path / "a.docx", robot=robot)


@pytest.mark.parametrize(("member", "others"), [("poses.npy", ["trans.npy"]), ("joint_pos.npy", ["body_pos_w.npy"]),
                                                ("contact.npy", []), ("x/data.pkl", [])])  # fmt: skip
def test_zip_bombs_are_refused_before_they_unpack(robot, tmp_path, member, others):
    path = tmp_path / "bomb"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open(member, "w") as entry,
    ):
        for _ in range(300):
            entry.write(bytes(2**20))
    with zipfile.ZipFile(path, "a") as archive:
        for other in others:
            archive.writestr(other, b"")
    tracemalloc.start()
    with pytest.raises(InputError, match="too large unpacked"):
        read_motion(path, robot=robot)
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()


def test_no_file(robot, tmp_path):
    for path, message in ((tmp_path / "no.bvh", "no such file"), (tmp_path, "is no file")):
        with pytest.raises(InputError, match=message):
            read_motion(path, robot=robot)


def test_too_large_a_file(robot, tmp_path):
    with (tmp_path / "big.bvh").open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(InputError, match=r"big\.bvh: file too large, got 1073741824 bytes"):
        read_motion(tmp_path / "big.bvh", robot=robot)


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """A few bytes changed, cut out, doubled or put in, or the end cut off."""
    content = bytearray(content)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(content))) if content else 0
        length = int(rng.integers(1, 12))
        match int(rng.integers(5)):
            case 0:
                content[at : at + 1] = bytes([int(rng.integers(256))])
            case 1:
                del content[at : at + length]
            case 2:
                content[at:at] = content[at : at + length]
            case 3:
                content[at:at] = rng.choice([b"nan", b"-", b"1e999", b"\n", b"{", b"}", b" 0 ", b"\x00", b"\xff"])
            case 4 if rng.random() < 0.2:
                del content[at:]
    return bytes(content)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("kind", Format)
def test_damaged_files_are_read_or_refused(robot, files, tmp_path, kind):
    """Several hundred each: nothing but an InputError of one line ever comes out, and no warning."""
    rng = np.random.default_rng(7)
    path = tmp_path / "damaged"
    refused = 0
    for _ in range(400):
        path.write_bytes(damaged(files[kind], rng))
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                read_motion(path, robot=robot)
        except InputError as error:
            refused += 1
            assert "\n" not in str(error) and len(str(error)) < 1000
    assert refused > 100


@needs_shared_data
def test_real_files(robot):
    files: dict[str, type] = {
        "bvh/mocapbank.bvh": HumanMotion,
        "g1moves/M_Move3.csv": Clip,
        "pbhc/Roundhouse_kick.pkl": Clip,
    }
    for name, kind in files.items():
        assert isinstance(read_motion(SHARED / name, robot=robot), kind)


def test_every_bundled_clip_reads_as_itself(robot):
    for path in sorted(Path(__file__).resolve().parents[2].glob("motion/clips/*.npz"))[:2]:
        assert read_motion(path, robot=robot).sha256 == open_motion(path.stem, robot).sha256
