"""What train/run.py was asked for."""

from collections.abc import Sequence
from pathlib import Path

from core.errors import InputError
from train.config import check, compose_document
from train.folder import ACTOR_FILE
from train.origins import told
from train.session import replay_dump, train
from train.setup import Setup, new_setup, resumed_setup

LAST_MILE = "last_mile"  # preset and folder


def execute(arguments: Sequence[str]) -> None:
    """Train anew or go on, replay a dump, or print the configuration.

    Raises:
        InputError: anything unusable.
        NonFiniteError: a number was NaN or infinite.
        ExportError: the actor could not be exported.
    """
    given = dict(argument.partition("=")[::2] for argument in arguments)
    if "--print" in given:
        overrides = [argument for argument in arguments if argument != "--print"]
        document = compose_document(overrides)
        check(document)
        print(*told(document, overrides), sep="\n")
    elif "replay" in given:
        if len(arguments) > 1:
            raise InputError("conflicts with replay", got=" ".join(arguments), expected="replay=NAN_DUMP alone")
        print(replay_dump(Path(given["replay"])))
    elif "resume" in given:
        rest = [argument for argument in arguments if not argument.startswith("resume=")]
        _train(resumed_setup(Path(given["resume"]).resolve(), rest))
    else:
        _train(new_setup(compose_document(arguments)))


def _train(setup: Setup) -> None:
    """The run, and the last mile where it is asked for: a run of its own in a folder of this one's."""
    if train(setup) != "completed" or setup.config.last_mile == "none":
        return
    kept = {name: setup.document[name] for name in ("motion", "motions", "robot", "seed", "precision", "threads")}
    told = [f"{name}={value}" for name, value in kept.items() if value is not None]
    source, folder = setup.run_dir / ACTOR_FILE, setup.run_dir / LAST_MILE
    train(new_setup(compose_document([*told, f"train={LAST_MILE}", f"init_from={source}", f"run_dir={folder}"])))
