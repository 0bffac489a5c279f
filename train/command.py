"""What train/run.py was asked for."""

from collections.abc import Sequence
from pathlib import Path

from core.errors import InputError
from train.config import check, compose_document
from train.origins import told
from train.session import replay_dump, train
from train.setup import new_setup, resumed_setup


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
        train(resumed_setup(Path(given["resume"]).resolve(), rest))
    else:
        train(new_setup(compose_document(arguments)))
