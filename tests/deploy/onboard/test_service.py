"""The systemd unit, read as systemd starts it."""

import shlex
from configparser import RawConfigParser
from pathlib import Path

from core.config import config_file
from deploy.cli import parse
from hal.dds.options import load_dds_options

UNIT = Path(__file__).resolve().parents[3] / "deploy" / "onboard" / "kata.service"


def test_what_it_starts_is_a_run_that_the_command_accepts():
    """Paths are those of the robot's computer; only the log's folder must exist, which systemd makes."""
    unit = RawConfigParser(strict=False)
    unit.read_string(UNIT.read_text().replace("\\\n", " "))
    program, *arguments = shlex.split(unit["Service"]["ExecStart"])
    assert Path(program).name == "python" and arguments[:2] == ["-P", "deploy/run"]
    log = arguments.pop(arguments.index("--log") + 1)
    assert log == "/var/log/" + unit["Service"]["LogsDirectory"]
    arguments.remove("--log")
    options = parse(arguments[2:])
    options.check()
    assert options.on_real_wire and options.attended
    assert load_dds_options(config_file("hal", "dds"), options.endpoints).interface == "eth0"
