"""What train/run.py was asked for."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from core.errors import InputError
from core.signals import StopRequest
from train.config import check, compose_document
from train.folder import ACTOR_FILE
from train.origins import told
from train.report.preset import nearest_preset
from train.session import replay_dump, train
from train.setup import Setup, check_new_run, new_setup, resumed_setup

LAST_MILE = "last_mile"  # preset and folder
HANDED_ON = ("motion", "motions", "robot", "seed", "precision", "device", "threads")
MET = ("clips", "events", "observations", "randomization", "sensing", "simulation")  # of the environment


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
    last_mile, stop = setup.config.last_mile != "none", StopRequest()
    if last_mile:
        check_new_run(setup.run_dir / LAST_MILE)  # before the hours that come first
    if train(setup, stop) == "completed" and last_mile and not stop.asked:
        train(new_setup(_last_mile(setup)), stop)


def _last_mile(setup: Setup) -> dict[str, Any]:
    """The last mile's document: of the run's it keeps :data:`HANDED_ON`, and in :data:`MET` what its preset lacks."""
    kept = {name: setup.document[name] for name in HANDED_ON if setup.document[name] is not None}
    source, folder = setup.run_dir / ACTOR_FILE, setup.run_dir / LAST_MILE
    told = [f"{name}={value}" for name, value in kept.items()]
    document = compose_document([*told, f"train={LAST_MILE}", f"init_from={source}", f"run_dir={folder}"])
    preset = compose_document(["motion=stand", f"train={nearest_preset(setup.document)[0]}"])
    own, usual, met = (each["environment"] for each in (setup.document, preset, document))
    return {**document, "environment": {**met, **{name: _changed(met[name], usual[name], own[name]) for name in MET}}}


def _changed(base: Any, before: Any, after: Any) -> Any:
    """``base``, changed as ``after`` is from ``before``: mappings key by key, anything else as a whole."""
    if before == after:
        return base
    if not all(isinstance(value, Mapping) for value in (base, before, after)):
        return after
    kept = {name: value for name, value in base.items() if name in after or name not in before}
    new = {name: value for name, value in after.items() if value != before.get(name)}
    return kept | {name: _changed(kept.get(name), before.get(name), value) for name, value in new.items()}
