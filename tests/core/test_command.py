"""How commands end."""

import pytest

from core.command import guarded
from core.errors import InputError


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (InputError("no such clip", got="x"), 2, "error: no such clip, got x\n"),
        (OSError("disk full"), 1, "error: disk full\n"),
        (KeyboardInterrupt(), 130, "stopped before the end\n"),
    ],
)
def test_an_error_is_an_exit_code_and_one_line(error, code, said, capsys):
    @guarded
    def main(arguments):
        raise error

    assert main([]) == code
    assert capsys.readouterr() == ("", said)


def test_a_code_is_handed_on_and_a_fault_of_the_program_is_not_hidden():
    assert guarded(lambda: 3)() == 3
    with pytest.raises(ZeroDivisionError):
        guarded(lambda: 1 // 0)()
