"""The command `motion/process`: recorded motions in, clips and reports out."""

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from core.arguments import ArgumentParser, number_argument, path_argument, positive_argument, positive_count_argument
from core.command import DONE, FAILED, guarded
from core.errors import InputError
from core.processes import available_cores
from motion.cli.dataset import done_already, files_in, read_manifest, write_manifest
from motion.cli.folder import REPORT_HTML, REPORT_JSON, check_folder, write_folder
from motion.cli.parallel import run_all
from motion.clip import clip_to_bytes
from motion.clip_set import MANIFEST
from motion.human.bvh import UNITS_M
from motion.human.placing import UPRIGHT_WXYZ
from motion.library import CLIPS, bundled_names
from motion.pipeline import ProcessRequest, process
from motion.report.record import TRACKABLE, document, json_text

DEFAULT_FOLDER = Path("motions")
MAX_NAME_BYTES = 200  # file systems take 255; endings and the marks of unfinished files come on top


@dataclass(frozen=True)
class Job:
    """One input, and the folder that receives what becomes of it; whether the folder around that is made as well, and
    whether an earlier result of the same is kept."""

    request: ProcessRequest
    folder: Path
    makes_parent: bool
    keeps: bool = False


def build_parser() -> ArgumentParser:
    """The options, as people script against them."""
    parser = ArgumentParser(
        "motion/process",
        description="Make clips that the robot can follow out of recorded motions. Ends with 1 when one is not "
        "trackable.",
        allow_abbrev=False,
    )
    add = parser.add_argument
    kinds = "AMASS .npz, GVHMR .pt, BVH, PBHC .pkl, CSV of 29 or 23 joints, mjlab .npz, kata clip"
    add("--input", type=path_argument, action="extend", nargs="+", required=True, metavar="FILE|FOLDER",
        help=f"one or several of {kinds}; told by their content; or a folder of them")  # fmt: skip
    add("--licence", metavar="TEXT", help="of a folder's motions, kept in its manifest")
    add("--name", metavar="N", help="of the clip (default: the file's)")
    add("--robot", default="g1_23dof", metavar="NAME|FILE", help="who is to follow it (default g1_23dof)")
    add("--fps", type=positive_argument, metavar="F", help="frame rate of the file, also against what it says")
    add("--start", type=number_argument, metavar="S", help="leave out what comes before S seconds")
    add("--end", type=positive_argument, metavar="E", help="leave out what comes after E seconds")
    add("--output", type=path_argument, metavar="DIR", help="receives N.npz and its report (default motions/N); of "
        "several inputs each has a folder in it")  # fmt: skip
    add("--loop", action="store_true", help="let the end run into the beginning")
    add("--mirror", action="store_true", help="exchange left and right")
    add("--skeleton", type=path_argument, metavar="FILE", help="mapping of a BVH skeleton that is not recognised")
    add("--unit", choices=tuple(UNITS_M), help="of a BVH's lengths, where its size does not tell")
    add("--up", choices=tuple(UPRIGHT_WXYZ), help="the file's axis that points up, where it is in doubt; --up=-y")
    add("--body-models", type=path_argument, metavar="DIR", help="the licensed SMPL or SMPL-X model files")
    add("--jobs", type=positive_count_argument, metavar="K", help="inputs at the same time (default: as many as cores)")
    return parser


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Process. Returns the exit code, the worst of all inputs: 0 trackable, 1 not trackable, 2 bad input."""
    options = build_parser().parse_args(arguments)
    folders = [path for path in options.input if path.is_dir()]
    if folders:
        return _process_folder(options, folders)
    if options.licence is not None:
        raise InputError("is said of a folder's motions", where="--licence", expected="a folder as --input")
    given = options.name
    jobs = jobs_of(options, [(path, path.stem if given is None else given) for path in options.input])
    return _run(options, jobs, jobs[0].folder.parent)[0]


def _run(options: argparse.Namespace, jobs: Sequence[Job], parent: Path) -> tuple[int, int]:
    """The worst exit code, and how many became clips that can be followed; the manifest in `parent` lists them, too.

    A folder that was named for one result is not made a set of clips by it.
    """
    read_manifest(parent)
    codes = run_all(_work, jobs, _workers(options, jobs))
    is_set = jobs[0].makes_parent or (parent / MANIFEST).is_file()
    if not is_set or all(code not in (DONE, FAILED) for code in codes) or not parent.is_dir():
        return max(codes), 0
    return max(codes), write_manifest(parent, [job.request.name for job in jobs], options.licence or "")


def _process_folder(options: argparse.Namespace, folders: Sequence[Path]) -> int:
    """All files of one folder, but for those that are done, and the manifest of what can be followed."""
    if len(options.input) > 1 or options.name is not None:
        raise InputError("a folder with other inputs, or a name", where="--input", expected="one folder, no --name")
    output = options.output or DEFAULT_FOLDER
    if output.resolve().is_relative_to(folders[0].resolve()):
        raise InputError("results among the inputs", where="--output", got=output, expected="a folder outside --input")
    jobs = [replace(job, keeps=True) for job in jobs_of(options, files_in(folders[0]))]
    code, number = _run(options, jobs, output)
    if (output / MANIFEST).is_file():
        print(f"{output / MANIFEST}: {number} of {len(jobs)} clips are trackable")
    else:
        print(f"{output}: no clip is trackable, see the report.html of each")
    return code


def _workers(options: argparse.Namespace, jobs: Sequence[Job]) -> int:
    return min(options.jobs or available_cores(), len(jobs))


def jobs_of(options: argparse.Namespace, inputs: Sequence[tuple[Path, str]]) -> list[Job]:
    """One job an input with its name. Raises InputError on options that contradict each other."""
    names = [checked_name(name, path if options.name is None else "--name") for path, name in inputs]
    if options.name is not None and len(names) > 1:
        raise InputError("one name for several inputs", where="--name", got=options.name, expected="no --name")
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        hint = "rename one of the files, or process them one by one with --name"
        raise InputError("inputs of one name", where="--input", got=", ".join(repeated), hint=hint)
    for path, name in inputs:
        if str(path) in bundled_names() and not path.exists():
            hint = f"for the clip that comes with kata: --input {CLIPS / path}.npz --name {name}"
            raise InputError("no such file", where="--input", got=path, hint=hint)
    start_s = options.start or 0.0
    if options.end is not None and options.end <= start_s:
        raise InputError("nothing is left", where="--end", got=options.end, expected=f"more than {start_s:g} s")
    one_folder = options.output is not None and len(names) == 1 and not options.input[0].is_dir()
    parent = options.output or DEFAULT_FOLDER
    return [
        Job(_request(options, path, name), parent if one_folder else parent / name, makes_parent=not one_folder)
        for (path, _), name in zip(inputs, names, strict=True)
    ]


def checked_name(name: str, where: object) -> str:
    """`name`, if files can be called so. Raises InputError, saying `where` it comes from."""
    if not name or Path(name).name != name or name.startswith((".", "-")) or not name.isprintable():
        raise InputError("cannot be a clip's name", where=where, got=repr(name), expected="a plain file name")
    if (size := len(os.fsencode(name))) > MAX_NAME_BYTES:
        expected = f"at most {MAX_NAME_BYTES}"
        raise InputError("too long for a clip's name", where=where, got=f"{size} bytes", expected=expected)
    return name


def _request(options: argparse.Namespace, path: Path, name: str) -> ProcessRequest:
    return ProcessRequest(
        file=path,
        name=name,
        robot=options.robot,
        fps=options.fps,
        start_s=options.start,
        end_s=options.end,
        loop=options.loop,
        mirror=options.mirror,
        skeleton=options.skeleton,
        unit=options.unit,
        up=options.up,
        body_models=options.body_models,
    )


@guarded
def _work(job: Job) -> int:
    """One input from end to end. Returns its exit code."""
    name = job.request.name

    def say(text: str) -> None:
        print(f"{name}: {text}", flush=True)

    check_folder(job.folder, makes_parent=job.makes_parent)
    verdict = done_already(job.request, job.folder) if job.keeps else None
    if verdict is not None:
        say(f"{verdict}, done already")
        return DONE if verdict == TRACKABLE else FAILED
    record = process(job.request, say)
    from motion.report.page import report_page  # draws: slow to load, and no use to who asks for help or errs

    say("report")
    files = {} if record.clip is None else {f"{name}.npz": clip_to_bytes(record.clip)}
    content = json_text(document(record))
    files |= {REPORT_HTML: report_page(record).encode(), REPORT_JSON: content.encode()}
    write_folder(job.folder, files, makes_parent=job.makes_parent)
    say(f"{record.verdict}, {job.folder}")
    for reason in record.reasons:
        say(f"  {reason}")
    return DONE if record.verdict == TRACKABLE else FAILED
