#!/usr/bin/env -S python3 -P
"""Train an actor of one motion, or one for many.

train/run.py motion=NAME|FILE or motions=FOLDER|MANIFEST, [KEY=VALUE ...] [--print]; resume=RUN_DIR; replay=NAN_DUMP.
Presets: train=clip|tracker|last_mile|goals|maskedmimic|maskedmimic_paper|window|paper|pbhc_release; motion= alone means
train=clip, motions= alone train=tracker. Keys: configs/train/config.yaml and the sections of the preset.
init_from=RUN_DIR|ACTOR begins with another training's weights, teacher=RUN_DIR|ACTOR learns from it. --print shows each
key, its value and where that is from, and trains nothing. Ctrl-C saves, exports and ends in good order.
"""

import os
import sys

# Busy waiting of OpenMP's threads steals the cores from physics; read once, when torch is loaded.
os.environ.setdefault("GOMP_SPINCOUNT", "2000")

NOT_INSTALLED = 'kata is not installed in this Python: run "make install", then ". .venv/bin/activate"'


def main(arguments: list[str]) -> int:
    """Run; return the exit code: 0 done or stopped in good order, 2 unusable input, 1 anything else."""
    if any(argument in ("-h", "--help") for argument in arguments):
        print(__doc__)
        return 0
    try:
        from core.launcher import ends_at_once

        with ends_at_once():
            from core.errors import InputError
            from train.command import execute
            from train.export import ExportError
            from train.nan_guard import NonFiniteError
    except ModuleNotFoundError as error:
        print(f"{NOT_INSTALLED} (no module {error.name})", file=sys.stderr)
        return 2
    try:
        execute(arguments)
    except InputError as error:
        print("error:", *str(error).splitlines(), file=sys.stderr)
        return 2
    except (NonFiniteError, ExportError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped before the training began: nothing written", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
