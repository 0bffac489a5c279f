"""What deploy/doctor finds on a computer that is a folder of files."""

import configparser
import re
from pathlib import Path

import numpy as np
import pytest

from core.config import config_file, load_options
from deploy.onboard.computer import Wanted
from deploy.onboard.doctor import late_us, main, wake_up
from hal.realtime import WIRE_PRIORITY

ONBOARD = Path(__file__).resolve().parents[3] / "deploy" / "onboard"
WANTED = load_options(Wanted, config_file("onboard", "doctor"))
FIT = {
    "proc/version": "Linux version 6.12.0-rt-amd64 (gcc 14) #1 SMP PREEMPT_RT Debian 6.12.1",
    "proc/self/limits": (
        "Limit                     Soft Limit           Hard Limit           Units     \n"
        "Max locked memory         unlimited            unlimited            bytes     \n"
        "Max realtime priority     70                   70                             \n"
    ),
    "proc/self/status": "Name:\tpython\nCapEff:\t0000000000000000\n",
    "sys/devices/system/cpu/online": "0-3",
    "sys/devices/system/cpu/isolated": "3",
    "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "performance",
    "sys/devices/system/cpu/cpu1/cpufreq/scaling_governor": "performance",
    "sys/power/state": "freeze mem",
    "run/systemd/inhibit/1": "WHO=kata\nWHAT=sleep:idle\nMODE=block\n",
    "sys/class/power_supply/BAT0/status": "Charging",
    "sys/class/net/can_left_leg/type": "280",
    "sys/class/net/can_left_leg/tx_queue_len": "16",
    "sys/class/net/can_left_leg/flags": "0x400c1",
    "sys/class/net/eth0/type": "1",
    "sys/class/net/eth0/tx_queue_len": "1000",
    "sys/class/net/eth0/flags": "0x1002",
    "sys/bus/usb-serial/devices/ttyUSB0/latency_timer": "1",
}


def computer(folder, changes):
    for name, content in (FIT | changes).items():
        if content is not None:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(content)
    return ["--root", str(folder)]


def test_a_fit_computer(tmp_path, capsys):
    assert main(computer(tmp_path, {})) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[-1] == "10 of 10 in order" and "do:" not in out and "eth0" not in out


BAD = [
    ({"proc/version": "Linux version 6.8.0-generic #1 SMP PREEMPT_DYNAMIC"}, "kernel", "real-time kernel"),
    ({"sys/devices/system/cpu/online": "0"}, "cores", "a core each"),
    ({"sys/devices/system/cpu/cpu1/cpufreq/scaling_governor": "powersave"}, "governor", "cpupower"),
    ({"sys/devices/system/cpu/isolated": ""}, "isolated cores", "isolcpus=3"),
    ({"proc/self/limits": FIT["proc/self/limits"].replace("70", "0 ")}, "real-time priority", "kata-limits.conf"),
    ({"proc/self/limits": FIT["proc/self/limits"].replace("unlimited", "8388608  ")}, "memory lock", "real-time"),
    ({"run/systemd/inhibit/1": "WHAT=sleep\nMODE=delay\n"}, "suspend", "systemctl mask"),
    ({"run/systemd/inhibit/1": None}, "suspend", "systemd-inhibit"),
    ({"sys/class/power_supply/BAT0/status": "Discharging"}, "power", "plug it in"),
    ({"sys/class/net/can_left_leg/tx_queue_len": "1000"}, "queue of can_left_leg", "txqueuelen 16"),
    ({"sys/class/net/can_left_leg/flags": "0x40080"}, "queue of can_left_leg", "99-kata.rules"),
    ({"sys/bus/usb-serial/devices/ttyUSB0/latency_timer": "16"}, "latency of ttyUSB0", "echo 1 > /sys/bus/usb-serial"),
]


@pytest.mark.parametrize(("changes", "what", "remedy"), BAD, ids=[f"{row[1]}-{row[2][:9]}" for row in BAD])
def test_each_shortcoming_is_one_row_with_what_to_do(tmp_path, capsys, changes, what, remedy):
    assert main(computer(tmp_path, changes)) == 4
    out = capsys.readouterr().out.splitlines()
    bad = [number for number, line in enumerate(out) if line.startswith("  NO")]
    assert len(bad) == 1 and out[bad[0]].startswith(f"  NO  {what}  ")
    assert out[bad[0] + 1].strip().startswith("do: ") and remedy in out[bad[0] + 1]
    assert out[-1] == "9 of 10 in order"


@pytest.mark.parametrize(
    "changes",
    [
        {"proc/version": "Linux version 5.15.0-rt17 #1 SMP PREEMPT RT", "sys/kernel/realtime": "1"},
        {"proc/self/limits": "", "proc/self/status": "CapEff:\t000001ffffffffff\n"},
        {"run/systemd/inhibit/1": None, "sys/power/state": ""},
    ],
    ids=["older real-time kernel", "root", "a kernel that cannot sleep"],
)
def test_other_ways_of_being_fit(tmp_path, changes):
    assert main(computer(tmp_path, changes)) == 0


def test_a_masked_sleep_target(tmp_path):
    arguments = computer(tmp_path, {"run/systemd/inhibit/1": None})
    assert main(arguments) == 4
    (tmp_path / "etc/systemd/system").mkdir(parents=True)
    (tmp_path / "etc/systemd/system/sleep.target").symlink_to("/dev/null")
    assert main(arguments) == 0


@pytest.mark.parametrize(
    ("p99_us", "most_us", "good"), [(150.0, 900.0, True), (250.0, 900.0, False), (150.0, 1100.0, False)]
)
def test_the_verdict_on_waking_up(p99_us, most_us, good):
    naps = np.concatenate([np.full(980, 50.0), np.full(19, p99_us), [most_us]])
    row = wake_up(naps, WANTED)
    assert row.good is good and row.found == f"p99 {p99_us:.0f} us, max {most_us:.0f} us"


def test_waking_up_is_measured():
    """Nobody wakes up before time, and nobody wakes up in no time at all."""
    measured = late_us(0.05, 0.001)
    assert measured.size == 50 and (measured >= 0.0).all() and measured.max() > 0.1


@pytest.mark.parametrize("arguments", [["--root", "/none"], ["--config", "none"], ["--seconds", "0"]])
def test_bad_input(arguments, capsys):
    assert main(arguments) == 2
    assert capsys.readouterr().err.startswith("error: ")


def test_the_files_beside_it_grant_what_it_wants():
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str
    unit.read(ONBOARD / "kata.service")
    service = unit["Service"]
    assert int(service["LimitRTPRIO"]) >= WANTED.rtprio == WIRE_PRIORITY and service["LimitMEMLOCK"] == "infinity"
    assert service["Restart"] == "no" and service["KillMode"] == "control-group"
    limits = (ONBOARD / "kata-limits.conf").read_text()
    assert int(re.search(r"rtprio +(\d+)", limits).group(1)) >= WANTED.rtprio and "memlock  unlimited" in limits
    rules = (ONBOARD / "99-kata.rules").read_text()
    assert f'tx_queue_len}}="{WANTED.can_queue}"' in rules and f'latency_timer}}="{WANTED.usb_latency_ms}"' in rules
