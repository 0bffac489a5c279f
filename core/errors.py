"""The error that a user's input causes."""


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
        parts = [what if where is None else f"{where}: {what}"]
        if got is not None:
            parts.append(f"got {got}")
        if expected is not None:
            parts.append(f"expected {expected}")
        message = ", ".join(parts)
        whole = message if hint is None else f"{message}; {hint}"
        super().__init__(" ".join(line for line in map(str.strip, whole.splitlines()) if line))
