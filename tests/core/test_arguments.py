"""Numbers as options' values: what is none is refused by name, and nothing is rounded or guessed."""

import pytest

from core.arguments import ArgumentParser, count_argument, number_argument, positive_argument, positive_count_argument
from core.errors import InputError


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (number_argument, "0", 0.0),
        (number_argument, "1e-3", 0.001),
        (positive_argument, "2.5", 2.5),
        (count_argument, "0", 0),
        (count_argument, "17", 17),
        (positive_count_argument, "1", 1),
    ],
)
def test_numbers(kind, text: str, value: float) -> None:
    parser = ArgumentParser("tool")
    parser.add_argument("--number", type=kind)
    assert parser.parse_args(["--number", text]).number == value


@pytest.mark.parametrize(
    ("kind", "text", "expected"),
    [
        (number_argument, "-1", "finite number from 0 up"),
        (number_argument, "nan", "finite number from 0 up"),
        (number_argument, "inf", "finite number from 0 up"),
        (number_argument, "two", "finite number from 0 up"),
        (positive_argument, "0", "number above 0"),
        (count_argument, "1.5", "whole number from 0 up"),
        (count_argument, "-1", "whole number from 0 up"),
        (positive_count_argument, "0", "whole number from 1 up"),
    ],
)
def test_what_is_no_such_number(kind, text: str, expected: str) -> None:
    parser = ArgumentParser("tool")
    parser.add_argument("--number", type=kind)
    with pytest.raises(InputError, match=f"--number: got {text}, expected a {expected}"):
        parser.parse_args([f"--number={text}"])
