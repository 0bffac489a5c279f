"""The command `motion/list`: the clips that come with kata and those in motions/."""

import sys
from collections.abc import Sequence
from pathlib import Path

from core.arguments import ArgumentParser
from core.command import BAD_INPUT, guarded
from core.errors import InputError
from core.text_table import text_table
from motion.clip import Clip, load_clip
from motion.library import CLIPS

LOCAL = Path("motions")
HEADS = ("clip", "seconds", "fps", "joints", "licence", "source")


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line a clip; 0 done, 2 a file in motions/ is no clip (the others are listed all the same)."""
    parser = ArgumentParser(
        "motion/list",
        description="Show the clips that come with kata, by name, and those in motions/, by file: "
        "what the other commands and train/run.py motion= take.",
        allow_abbrev=False,
    )
    parser.parse_args(arguments)
    found = {path.stem: path for path in sorted(CLIPS.glob("*.npz"))}
    found |= {str(path): path for path in sorted([*LOCAL.glob("*.npz"), *LOCAL.glob("*/*.npz")])}
    rows, errors = [], []
    for name, path in found.items():
        try:
            rows.append((name, *_facts(load_clip(path))))
        except InputError as error:
            errors.append(f"error: {error}")
    print(text_table(HEADS, rows, right=(1, 2, 3)), flush=True)
    for line in errors:
        print(line, file=sys.stderr)
    return BAD_INPUT if errors else 0


def _facts(clip: Clip) -> tuple[str, ...]:
    return f"{clip.duration_s:.1f}", f"{clip.fps:g}", str(clip.num_joints), clip.license, clip.source
