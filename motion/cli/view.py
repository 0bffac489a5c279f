"""The command `motion/view`: a clip as a video, or in the browser."""

import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from core.arguments import ArgumentParser, path_argument, positive_argument
from core.command import guarded
from core.files import check_output_file, check_output_kind
from motion.cli.serving import serve
from motion.clip import Clip
from motion.library import open_motion
from motion.report import figures
from motion.report.film import film
from motion.report.trace import trace_clip
from robot.robot import Robot, load_robot
from view import page as part


def build_parser() -> ArgumentParser:
    """The options, as people script against them."""
    parser = ArgumentParser(
        "motion/view",
        description="Play a clip beside its joint angles and contacts, as a video or in the browser.",
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("clip", metavar="CLIP", help="bundled name, or a file of a robot's motion")
    add("--video", type=path_argument, metavar="FILE", help="MP4 to write (default: the clip's name, here)")
    add("--web", action="store_true", help="serve a page with video and plots to this machine, until Ctrl-C")
    add("--robot", default="g1_23dof", metavar="NAME|FILE", help="whose motion it is (default g1_23dof)")
    add("--fps", type=positive_argument, metavar="F", help="frame rate of the file, also against what it says")
    return parser


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Play. Returns the exit code."""
    options = build_parser().parse_args(arguments)
    name = Path(options.clip).stem
    with ExitStack() as stack:
        video = options.video
        if video is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory())) if options.web else Path()
            video = folder / f"{name}.mp4"
        check_output_kind(video, (".mp4",))
        check_output_file("--video", video)
        robot = load_robot(options.robot)
        clip = open_motion(options.clip, robot, csv_fps=options.fps)
        film(clip, robot, video, _progress)
        if not options.web:
            print(f"video: {video}")
            return 0
        content = web_page(name, clip, robot, video.read_bytes())
    serve(content.encode())
    return 0


def web_page(name: str, clip: Clip, robot: Robot, mp4: bytes) -> str:
    """The page: the video, feet, joint angles and speeds."""
    trace = trace_clip(clip, robot)
    plots = (figures.feet_over_time(trace), figures.joint_angles(trace, robot), figures.joint_speeds(trace, robot))
    captions = (figures.FEET_CAPTION, figures.ANGLES_CAPTION, figures.SPEEDS_CAPTION)
    facts = f"{clip.duration_s:.1f} s at {clip.fps:g} frames per second; {clip.source}; {clip.license}"
    body = part.heading(name, level=1) + part.paragraph(facts, "small") + part.video(mp4)
    return part.whole_page(name, body + "".join(map(part.picture, plots, captions)))


def _progress(number: int, total: int) -> None:
    """A line every tenth of the way."""
    if 10 * number // total > 10 * (number - 1) // total:
        print(f"picture {number} of {total}", file=sys.stderr, flush=True)
