"""Tables on a terminal."""

from collections.abc import Sequence

WIDEST_CELL = 60


def text_table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[int] = (), widest: int = WIDEST_CELL
) -> str:
    """Lines of columns two spaces apart, as wide as their widest cell; the columns `right` are set to the right.

    Cells longer than `widest` are cut; what a terminal would obey (texts come from files) becomes a question mark.
    """
    lines = [[_shown(text, widest) for text in line] for line in (heads, *rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(heads))]

    def cell(text: str, column: int) -> str:
        return text.rjust(widths[column]) if column in right else text.ljust(widths[column])

    return "\n".join("  ".join(cell(text, i) for i, text in enumerate(line)).rstrip() for line in lines)


def _shown(text: str, widest: int) -> str:
    plain = "".join(letter if letter.isprintable() else "?" for letter in text)
    return plain if len(plain) <= widest else plain[: widest - 1] + "…"
