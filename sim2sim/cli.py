"""The command `sim2sim/evaluate`: options in, table, JSON, video and report out."""

import argparse
import time
from collections.abc import Callable, Sequence

from core.arguments import ArgumentParser, count_argument, number_argument, path_argument, positive_count_argument
from core.command import guarded
from core.errors import InputError
from core.files import check_output_file, check_output_folder, check_output_kind, write_json
from policy.goals import KINDS
from robot.robot import load_robot
from sim2sim.evaluation import Evaluation, evaluate
from sim2sim.player import Player
from sim2sim.progress import Progress
from sim2sim.request import EvaluationRequest
from sim2sim.steered import TASKS, evaluate_steered, steered_table
from sim2sim.stress import load_conditions, stress, stress_document, stress_table
from sim2sim.table import clip_table, format_table
from world.model import check_meshes

Writer = Callable[[Evaluation], None]
SET_BY_CONDITIONS = ("sim", "friction", "delay", "push", "episodes", "randomize", "video", "report")


def build_parser() -> ArgumentParser:
    """The options, as people script against them."""
    parser = ArgumentParser("sim2sim/evaluate", description="Score actors in simulation.", allow_abbrev=False)
    add = parser.add_argument
    add("--policy", action="append", required=True, metavar="NAME|FILE", help="actor; give several to compare them")
    add(
        "--motion",
        action="append",
        default=[],
        metavar="FILE",
        help="clip for an actor that carries none, a folder of clips, or a manifest; give several for a row each",
    )
    shown = (
        "what an actor that follows goals is shown of the clip (full); without --motion steer, path, reach: by chance"
    )
    add("--goal", choices=tuple(KINDS), default="full", help=shown)
    add("--robot", default="g1_23dof", metavar="NAME|FILE")
    simulations = "reference: 200 Hz, no delay; limits on targets and torques only count, a trip still ends an episode"
    add("--sim", choices=("default", "reference"), default="default", help=simulations)
    add("--sim-model", type=path_argument, metavar="FILE", help="another MJCF with the same joint names")
    add("--start", choices=("reference", "stand"), default="reference", help="the clip's first frame, or the ground")
    add(
        "--start-noise",
        type=number_argument,
        default=0.0,
        metavar="RAD",
        help="std of a normal added to each joint position",
    )
    add("--friction", type=number_argument, metavar="F", help="sliding friction of every contact")
    add("--delay", type=number_argument, metavar="MS", help="targets reach the motors this much later")
    add("--push", type=number_argument, metavar="V", help="kick of V m/s every 5 s")
    add("--episodes", type=positive_count_argument, default=1, metavar="N", help="how many of each actor (default 1)")
    add("--randomize", action="store_true", help="robot, ground, delay, pushes and sensor noise differ by episode")
    add("--stress", action="store_true", help="a row for each condition of configs/evaluate/stress.yaml")
    add("--seed", type=count_argument, default=0, metavar="S", help="the same seed gives the same numbers (default 0)")
    add("--json", type=path_argument, metavar="F", help="write the scores")
    add("--video", type=path_argument, metavar="F", help="first episode of each actor beside the reference, MP4")
    add("--report", type=path_argument, metavar="DIR", help="write report.html: scores, plots, pictures")
    add("--meshes", type=path_argument, metavar="DIR", help="the maker's STL files, shown in video and report")
    return parser


def request_of(options: argparse.Namespace) -> EvaluationRequest:
    """The parsed options as a request, in SI units."""
    return EvaluationRequest(
        policies=tuple(options.policy),
        motions=tuple(options.motion),
        goal=options.goal,
        robot=options.robot,
        sim=options.sim,
        sim_model=options.sim_model,
        start=options.start,
        start_noise_rad=options.start_noise,
        friction=options.friction,
        delay_s=None if options.delay is None else 1e-3 * options.delay,
        push_m_s=options.push,
        episodes=options.episodes,
        randomize=options.randomize,
        seed=options.seed,
    )


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Evaluate. Returns the exit code."""
    options = build_parser().parse_args(arguments)
    check_output_file("--json", options.json)
    check_output_file("--video", options.video)
    check_output_folder("--report", options.report)
    if options.meshes is not None:
        check_meshes(load_robot(options.robot), options.meshes)
    if options.goal not in ("full", *TASKS) and not options.motion:
        raise InputError(f"--goal {options.goal} shows a part of a clip", hint="give --motion")
    if options.goal in TASKS and not options.motion:
        _steer(options)
    elif options.stress:
        _stress(options)
    else:
        _run(request_of(options), _writers(options))
    return 0


def _stress(options: argparse.Namespace) -> None:
    """Every condition; its own options decide, and the rest would contradict them."""
    usual = build_parser().parse_args(["--policy", options.policy[0]])
    for name in SET_BY_CONDITIONS:
        if getattr(options, name) != getattr(usual, name):
            option = "--" + name.replace("_", "-")
            raise InputError(f"{option} does not go with --stress", hint="the conditions of the table say it")
    rows = stress(request_of(options), load_conditions(), _played)
    print(stress_table(rows))
    if options.json:
        write_json(options.json, stress_document(rows))


def _steer(options: argparse.Namespace) -> None:
    """What is steered by chance has no reference, so there are neither pictures nor a clip's first frame."""
    usual = build_parser().parse_args(["--policy", options.policy[0]])
    for name in ("video", "report", "stress", "start"):
        if getattr(options, name) != getattr(usual, name):
            raise InputError(f"--{name} does not go with {TASKS[options.goal]}", hint="give --motion besides --goal")
    request = request_of(options)
    progress = Progress(request.episodes * len(request.policies))
    documents = evaluate_steered(request, lambda score: progress.count(ended_early=score.ended != "completed"))
    progress.end()
    print(steered_table(documents))
    if options.json:
        write_json(options.json, {"runs": documents})


def _played(request: EvaluationRequest) -> Evaluation:
    player = Player(request)
    progress = Progress(request.episodes * len(player.runs))
    evaluation = evaluate(player, progress)
    progress.end()
    return evaluation


def _run(request: EvaluationRequest, writers: Sequence[Writer]) -> None:
    started_s = time.monotonic()
    evaluation = _played(request)
    print(f"{request.episodes} episodes each, simulation {request.sim}, {time.monotonic() - started_s:.1f} s")
    table = clip_table if len(evaluation.player.clips) > 1 else format_table
    print(table([run.document for run in evaluation.runs], [run.name for run in evaluation.runs]))
    print(*evaluation.remarks(), sep="\n")
    for write in writers:
        write(evaluation)


def _writers(options: argparse.Namespace) -> list[Writer]:
    """What to do with the results; what pictures need is imported here, before any episode."""
    writers: list[Writer] = []
    if options.json:
        writers.append(lambda evaluation: write_json(options.json, evaluation.document()))
    try:
        if options.video:
            from sim2sim.video import write_video

            check_output_kind(options.video, (".mp4",))
            writers.append(lambda evaluation: write_video(options.video, evaluation, options.meshes))
        if options.report:
            from sim2sim.report import write_report

            writers.append(lambda evaluation: write_report(options.report, evaluation, options.meshes))
    except ModuleNotFoundError as error:
        hint = "run make install, or pip install -e '.[view]'"
        raise InputError("pictures need a package that is not installed", got=error.name, hint=hint) from error
    return writers
