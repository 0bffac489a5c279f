"""The error that a user's input causes."""

from __future__ import annotations


class InputError(ValueError):
    """Unusable input. ``str()`` is one line: what, where, got, expected, what to do."""

    def __init__(
        self,
        what: str,
        *,
        where: object = None,
        got: object = None,
        expected: object = None,
        hint: str | None = None,
    ) -> None:
        parts = [what]
        if got is not None:
            parts.append(f"got {got}")
        if expected is not None:
            parts.append(f"expected {expected}")
        self._where = "" if where is None else str(where)
        self._fault = ", ".join(parts) + (f"; {hint}" if hint else "")
        message = self._fault if where is None else f"{where}: {self._fault}"
        super().__init__(" ".join(line for line in map(str.strip, message.splitlines()) if line))

    def inside(self, section: str) -> InputError:
        """The same error with the path of its ``section`` before its own place, where it does not say so itself."""
        own = self._where
        if not section or own == section or own.startswith(tuple(section + end for end in ".[:")):
            return self
        return InputError(self._fault, where=f"{section}.{own}" if own else section)
