"""The sections of process.yaml, and what is said about broken ones."""

from dataclasses import dataclass, fields

import pytest

from core.errors import InputError
from motion.contact import ContactSettings
from motion.finish.settings import FinishSettings
from motion.human.correct import CorrectSettings
from motion.plausibility import FilterSettings
from motion.report.warnings import WarningSettings
from motion.settings import read_section


@dataclass(frozen=True)
class Two:
    a_s: float
    b_m: float


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (FilterSettings, "filter"),
        (ContactSettings, "contact"),
        (CorrectSettings, "correct"),
        (FinishSettings, "finish"),
        (WarningSettings, "warnings"),
    ],
)
def test_every_section_fits(kind, name):
    assert all(isinstance(getattr(read_section(kind, name), field.name), float) for field in fields(kind))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("two: {a_s: 1, b_m: x}", "two.b_m: wrong type, got 'x', expected a number in m"),
        ("two: {a_s: 1, b_m: .nan}", "two.b_m: not finite, got nan"),
        ("two: {a_s: 1, b_m: -2}", "two.b_m: too small, got -2.0, expected at least 0 m"),
        ("two: {a_s: 1}", "two.b_m: missing key, got a_s"),
        ("two: {a_s: 1, b_m: 2, c: 3}", "two.c: unknown key, expected one of a_s, b_m"),
        ("two: 5", "two: wrong type, got 5, expected a mapping"),
        ("one: {}", "two: missing key, got one"),
        ("two: [", "not a readable YAML file"),
    ],
)
def test_a_broken_section_is_named(tmp_path, content, message):
    path = tmp_path / "process.yaml"
    path.write_text(content)
    with pytest.raises(InputError) as error:
        read_section(Two, "two", path)
    assert str(error.value).startswith(str(path)) and message in str(error.value)


def test_numbers_are_read(tmp_path):
    path = tmp_path / "process.yaml"
    path.write_text("one: {x: 3}\ntwo: {a_s: 1, b_m: 0.5}")
    assert read_section(Two, "two", path) == Two(1.0, 0.5)


def test_no_file(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_section(Two, "two", tmp_path / "process.yaml")
