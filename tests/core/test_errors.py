"""Errors that people cause are one line."""

import pickle

import numpy as np
import pytest

from core.arguments import ArgumentParser, path_argument
from core.errors import InputError


def test_an_error_says_what_where_got_expected_and_what_to_do():
    error = InputError("too small", where="num_envs", got=0, expected="at least 1", hint="try 512")
    assert str(error) == "num_envs: too small, got 0, expected at least 1; try 512"


def test_an_error_is_one_line_whatever_it_quotes():
    assert (
        str(InputError("unreadable", got="while parsing\n  a flow node\n"))
        == "unreadable, got while parsing a flow node"
    )
    row = np.arange(40.0)
    assert "\n" in str(row)
    message = str(InputError("joints", where="clip.npz", got=row, expected=np.zeros((2, 2)), hint="a\r\n\n b"))
    assert message.splitlines() == [message] and message.endswith("39.], expected [[0. 0.] [0. 0.]]; a b")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--nosuch"], "unrecognized arguments: --nosuch; see room/command --help"),
        (["--out", ""], "argument --out: got nothing, expected a path; see room/command --help"),
        (["--count", "two"], "argument --count: invalid int value: 'two'; see room/command --help"),
    ],
)
def test_bad_usage_is_such_an_error(arguments, message):
    parser = ArgumentParser("room/command")
    parser.add_argument("--out", type=path_argument)
    parser.add_argument("--count", type=int)
    with pytest.raises(InputError) as caught:
        parser.parse_args(arguments)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("where", "section", "expected"),
    [
        ("speed_rad_s", "stand_up", "stand_up.speed_rad_s: too fast, got 2; slow down"),
        ("tilt.ticks", "safety", "safety.tilt.ticks: too fast, got 2; slow down"),
        (None, "motors[3 knee]", "motors[3 knee]: too fast, got 2; slow down"),
        ("learner.clip", "learner", "learner.clip: too fast, got 2; slow down"),
        ("learner_clip", "learner", "learner.learner_clip: too fast, got 2; slow down"),
        ("speed_rad_s", "", "speed_rad_s: too fast, got 2; slow down"),
    ],
)
def test_the_path_of_a_section_goes_before_the_place(where, section, expected):
    error = InputError("too fast", where=where, got=2, hint="slow down")
    assert str(error.inside(section)) == expected
    assert str(pickle.loads(pickle.dumps(error)).inside(section)) == expected
