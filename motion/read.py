"""Any motion file: of a human as a HumanMotion, of the robot's joints as a Clip."""

from dataclasses import replace
from pathlib import Path

from core.config import errors_in
from core.errors import InputError
from motion.clip import Clip, clip_from_bytes
from motion.formats import HUMAN_FORMATS, Format, format_of
from motion.human.bvh import bvh_motion
from motion.human.motion import HumanMotion
from motion.human.placing import placed
from motion.human.smpl import AMASS_FIELDS, read_amass, read_gvhmr, smpl_motion
from motion.importers import mjlab_npz
from motion.importers.csv_joints import read_csv_joints
from motion.importers.pbhc_pkl import read_pbhc
from motion.importers.torch_file import read_torch
from motion.npz import read_file, read_npz
from motion.reference import joint_columns
from robot.robot import Robot

_USED = {
    Format.BVH: ("--skeleton", "--unit", "--up"),
    Format.AMASS: ("--up", "--body-models"),
    Format.GVHMR: ("--up", "--body-models"),
}  # what else than the frame rate may be given


def read_motion(
    path: Path,
    *,
    fps: float | None = None,
    robot: Robot,
    skeleton: Path | None = None,
    body_models: Path | None = None,
    unit: str | None = None,
    up: str | None = None,
) -> HumanMotion | Clip:
    """The motion in the file at `path`, its format told by the content (motion.formats); see the `notes` of a
    HumanMotion for what was detected, and `created_by` of a Clip.

    `fps` is the frame rate of a file that does not state one, and counts more than a stated one. For BVH files:
    `skeleton`, a mapping of joints that are not recognised, and `unit` (m, cm, mm, inch, cmu). For SMPL parameters:
    `body_models`, the folder of the licensed model files. `up`, the axis that points up in the file (x, y, z, -x, -y,
    -z). The last two are detected where not given. A Clip's joints are those of `robot`.

    Raises InputError: no such file, unknown, damaged, too large, something that must be said by an option, or an option
    for which the format has no use.
    """
    path = Path(path)
    content = read_file(path)
    kind, where = format_of(content, path), str(path)
    given = {"--skeleton": skeleton, "--unit": unit, "--up": up, "--body-models": body_models}
    unused = [option for option, value in given.items() if value is not None and option not in _USED.get(kind, ())]
    if unused:
        raise InputError(f"{kind.value} has no use for {', '.join(unused)}", where=where, hint="leave it out")
    if kind not in HUMAN_FORMATS:
        return read_clip(content, kind, where, robot, fps)
    if kind is Format.BVH:
        recording = bvh_motion(content, where, fps=fps, unit=unit, skeleton=skeleton)
    elif kind is Format.AMASS:
        recording = smpl_motion(read_amass(read_npz(content, where, AMASS_FIELDS), where, fps), body_models)
    else:
        recording = smpl_motion(read_gvhmr(read_torch(content, where), where, fps), body_models)
    return placed(recording, up, where, path.name)


def read_clip(content: bytes, kind: Format, where: str, robot: Robot, fps: float | None = None) -> Clip:
    """The Clip in a file of robot joints given as bytes. `fps`: see read_motion. Raises InputError naming `where`."""
    if kind is Format.CSV:
        return read_csv_joints(content, where, robot, fps)
    if kind is Format.MJLAB:
        return mjlab_npz.read_mjlab(read_npz(content, where, mjlab_npz.FIELDS), where, robot, fps)
    clip = clip_from_bytes(content, where) if kind is Format.CLIP else read_pbhc(content, where)
    joint_columns(clip, robot, where)
    with errors_in(where):
        return clip if fps is None else replace(clip, fps=fps)
