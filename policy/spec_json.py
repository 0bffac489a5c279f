"""The actor's spec as one JSON document, at full precision; the inverse names the field of everything unusable."""

from __future__ import annotations

import json
from dataclasses import asdict, fields

import numpy as np

from core.config import read_json
from core.errors import InputError
from core.structured import check_keys, parse
from policy.spec import ActorSpec, ObservationTerm, check_schema

WHERE = "actor_spec"
# May be absent from a document. All other fields stand there, also those that have a default in memory.
_SINCE_SCHEMA_2 = ("ticks", "of", "part", "mean", "follows", "commands", "maps", "held_joints")


def spec_to_json(spec: ActorSpec) -> str:
    """One JSON document; every float64 survives the round trip exactly. InputError if not finite."""
    try:
        return json.dumps(asdict(spec), default=np.ndarray.tolist, allow_nan=False, sort_keys=True)
    except (TypeError, ValueError) as error:
        raise InputError(f"cannot be written as JSON ({error})", where=WHERE) from error


def spec_from_json(text: str) -> ActorSpec:
    """Inverse of `spec_to_json`, also for documents of schema 1.

    InputError for malformed JSON, missing, unknown or unusable fields.
    """
    document = read_json(text, WHERE)
    if isinstance(document, dict):
        check_schema(document.get("schema_version"))
    _check_fields(ActorSpec, document, WHERE)
    spec = parse(ActorSpec, document)
    for i, group in enumerate(document["observations"]):
        for k, term in enumerate(group["terms"]):
            _check_fields(ObservationTerm, term, f"observations[{i} {group['name']}].terms[{k} {term['term']}]")
    return spec


def _check_fields(kind: type, document: object, where: str) -> None:
    check_keys(document, [entry.name for entry in fields(kind)], where, optional=_SINCE_SCHEMA_2)
