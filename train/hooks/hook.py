"""When a hook is called."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from train.runner import Runner


class Hook:
    """Base of all hooks: does nothing."""

    def before_run(self, run: "Runner") -> None:
        """Called once, before the first iteration."""

    def after_iteration(self, run: "Runner", row: dict[str, Any]) -> None:
        """Called after each iteration; ``row`` has its figures and takes others."""

    def after_run(self, run: "Runner") -> None:
        """Called once, when the run ended in order."""

    def after_failure(self, run: "Runner") -> None:
        """Called once instead, when a number was not finite."""

    def state_dict(self) -> dict[str, Any]:
        """What a continued run needs."""
        return {}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned; nothing where that was empty."""


def is_due(every: int | None, iteration: int) -> bool:
    """Whether ``every`` so many iterations, if at all, it is time."""
    return every is not None and iteration % every == 0
