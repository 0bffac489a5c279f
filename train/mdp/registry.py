"""Terms by name: short functions that a configuration lists with their parameters."""

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Generic, TypeVar

from core.errors import InputError

F = TypeVar("F", bound=Callable[..., Any])


class Registry(Generic[F]):
    """Functions under their own names. Keyword-only arguments are the parameters that a configuration may set.

    Args:
        kind: what a term is called in errors.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._terms: dict[str, F] = {}

    def __call__(self, function: F) -> F:
        """Register ``function``, for use as a decorator. ValueError if its name is taken."""
        name = function.__name__
        if name in self._terms:
            raise ValueError(f"{self._kind} {name!r} is registered twice")
        self._terms[name] = function
        return function

    def __getitem__(self, name: str) -> F:
        return self._terms[name]

    def __contains__(self, name: object) -> bool:
        return name in self._terms

    @property
    def names(self) -> list[str]:
        """Every registered name, sorted."""
        return sorted(self._terms)

    def bound(self, name: str, params: Mapping[str, float]) -> Callable[..., Any]:
        """The term with its parameters set."""
        return partial(self._terms[name], **params)

    def check(self, where: str, name: str, params: Mapping[str, float]) -> None:
        """InputError naming ``where`` unless the term exists and takes these parameters, all that it needs."""
        if name not in self._terms:
            raise InputError(f"unknown {self._kind}", where=where, expected=self.names)
        known = {
            p.name: p.default is inspect.Parameter.empty
            for p in inspect.signature(self._terms[name]).parameters.values()
            if p.kind is inspect.Parameter.KEYWORD_ONLY
        }
        for given in params:
            if given not in known:
                expected = "one of " + ", ".join(known) if known else "no parameter"
                raise InputError("unknown parameter", where=f"{where}.{given}", expected=expected)
        if missing := [param for param, needed in known.items() if needed and param not in params]:
            raise InputError("missing parameter", where=f"{where}.{missing[0]}", expected="a number")
