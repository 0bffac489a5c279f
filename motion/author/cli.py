"""`motion/author/build`: rebuild the bundled clips from their choreographies."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from core.arguments import ArgumentParser, path_argument
from core.command import guarded
from core.errors import InputError
from motion.author.choreography import GROUPS, Choreography, load_choreography
from motion.author.solver import solve_frames
from motion.author.stand import SIDES, StandPose, stand_pose
from motion.author.targets import body_targets, corrected
from motion.clip import Clip, save_clip
from robot.robot import Robot, load_robot

ROOT = Path(__file__).resolve().parents[2]
CHOREOGRAPHIES = ROOT / "configs" / "motion"
CLIPS = ROOT / "motion" / "clips"
SETTINGS = "process"  # lies beside the choreographies: the settings of motion/process
CORRECTIONS = 4


def choreography_names() -> list[str]:
    """Names of the choreographies in configs/motion."""
    return sorted(path.stem for path in CHOREOGRAPHIES.glob("*.yaml") if path.stem != SETTINGS)


def build_clip(path: Path, robot: Robot) -> Clip:
    """Clip of the choreography file at `path`. Raises InputError naming file and key."""
    stand = stand_pose(robot)
    choreography = choreography_of(path, stand)
    targets = body_targets(choreography, stand)
    qpos, wanted_zmp_w = solve_frames(robot, stand, choreography, targets), targets.zmp_w
    for _ in range(CORRECTIONS):
        targets = corrected(targets, stand, qpos, wanted_zmp_w)
        qpos = solve_frames(robot, stand, choreography, targets)
    return Clip(
        fps=choreography.fps,
        joint_names=robot.joint_names,
        root_pos_w=qpos[:, :3],
        root_quat_wxyz=qpos[:, 3:7],
        joint_pos_rad=qpos[:, 7:],
        contact=targets.contact,
        source="kata choreography",
        license="Apache-2.0",
        created_by="kata motion/author",
    )


def choreography_of(path: Path, stand: StandPose) -> Choreography:
    """The choreography file at `path` for who stands like that. Raises InputError naming file and key."""
    feet_m = {side: (float(x), float(y)) for side, (x, y, _) in zip(SIDES, stand.foot_pos_w, strict=True)}
    return load_choreography(path, _stand_values(stand), feet_m)


def _stand_values(stand: StandPose) -> dict[str, tuple[float, ...]]:
    """Values of every group in the stand pose."""
    values = {group: (0.0,) * len(channels) for group, channels in GROUPS.items()}
    values["balance"] = (0.5, 0.0)
    for side in SIDES:
        arm = stand.arms[side]
        values[f"{side}_arm"] = (*(float(x) for x in arm.hand_m), arm.swivel_rad())
    return values


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Build the named clips, or all; 0 done, 2 a wrong choreography or name."""
    parser = ArgumentParser(prog="motion/author/build", description=__doc__)
    names = choreography_names()
    text = f"clips to build: {', '.join(names)} (default: all of these), or choreography files (.yaml)"
    parser.add_argument("names", nargs="*", metavar="NAME|FILE", help=text)
    parser.add_argument(
        "--out", type=path_argument, default=CLIPS, metavar="DIR", help="folder for the clips, made if need be"
    )
    options = parser.parse_args(arguments)
    files = [Path(name) for name in options.names if name.endswith(".yaml")]
    if unknown := [name for name in options.names if name not in names and Path(name) not in files]:
        raise InputError("no such choreography", got=", ".join(unknown), expected=f"some of {', '.join(names)}")
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError("cannot be made", where=f"--out {options.out}", got=reason, expected="a folder") from None
    robot = load_robot()
    for name in options.names or names:
        path = Path(name) if name.endswith(".yaml") else CHOREOGRAPHIES / f"{name}.yaml"
        clip = build_clip(path, robot)
        save_clip(clip, options.out / f"{path.stem}.npz")
        speed = np.abs(np.diff(clip.joint_pos_rad, axis=0)).max() * clip.fps
        print(f"{path.stem}: {clip.duration_s:g} s, fastest joint {speed:.1f} rad/s, sha256 {clip.sha256[:12]}")
    return 0
