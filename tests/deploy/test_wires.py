"""deploy/run on a wire: who may start, what a dry run writes, what is recorded. The wire's driver is a fake."""

import contextlib
import json
import math
import os
import pty
import select
import signal
import termios
import threading
import time
from dataclasses import fields, replace
from types import MappingProxyType, SimpleNamespace

import pytest
import yaml
from mcap.reader import make_reader

import deploy.session
import hal.open
from core.clock import SimulatedClock
from core.config import config_file
from core.errors import InputError
from deploy.cli import main
from deploy.dry_run_record import DAY_S, DryRunRecord, require_records
from deploy.operator.far_end import ASK, WELL
from deploy.options import RunOptions
from hal.simulated.mock import MockBackend, MockOptions
from hal.verification.record import VerifiedRecord
from hal.wire.backend import WireBackend
from tests.deploy.toys import write_standing_actor
from tests.hal.wire.fake import KNEE_SERIAL, read_journal
from tests.hal.wire.test_process import wait_until


def patient_settings():
    """The defaults, but a machine that pauses for a second trips nothing: what trips is tests/hal/conformance's."""
    settings = yaml.safe_load(config_file("deploy", "default").read_text())
    settings["safety"]["stale"] = {"limit_periods": 50.0, "trip_periods": 50.0}
    settings["preflight"] |= {"age_periods": 50.0, "dry_run_overruns": 1.0}
    settings["preflight"] |= {"settle_s": 0.2, "samples": 5, "dry_run_s": 1.2}  # the fake rests at once
    settings["safety"]["inference_overrun"]["periods"] = 50.0
    return yaml.safe_dump(settings)


@pytest.fixture
def rig(tmp_path, monkeypatch):
    """Command line, journal and records of a backend named can whose driver is the fake."""
    write_standing_actor(tmp_path / "stand.onnx")
    write_standing_actor(tmp_path / "clip.onnx", seconds=1.0, name="clip")
    (tmp_path / "wire.yaml").write_text("a: 1\n")
    (tmp_path / "patient.yaml").write_text(patient_settings())
    monkeypatch.setitem(hal.open.WIRES, "can", ("tests.hal.wire.fake", str(tmp_path / "wire.yaml")))
    monkeypatch.setattr(deploy.session, "RECORDS", tmp_path / "records")
    monkeypatch.setattr(deploy.session, "VERIFIED", tmp_path / "verified")
    monkeypatch.setenv("FAKE_WIRE_JOURNAL", str(tmp_path / "journal"))

    def run(*options):
        common = ["--policy", str(tmp_path / "clip.onnx"), "--stand", str(tmp_path / "stand.onnx")]
        common += ["--config", str(tmp_path / "patient.yaml")]
        return main(["--backend", "can", *common, *map(str, options)])

    def verify(serial, others=MappingProxyType({})):
        """What hal/verify leaves, for the robot whose knee has this number, and other parts theirs."""
        sha256 = hal.open.wire_config_sha256("can", None, {})
        VerifiedRecord(sha256, "g1_23dof", {"left_knee_joint": serial, **others}).save(tmp_path / "verified", {})

    run.folder, run.verify = tmp_path, verify
    verify(KNEE_SERIAL)
    return run


class Journalled(MockBackend):
    """What the fake's process does to its device and notes of it, without the process."""

    def __init__(self, robot, clock, period_s, journal):
        super().__init__(robot, clock, MockOptions(0.2, 0.1, 35.0), control_period_s=period_s)
        self._journal = journal

    def note(self, event):
        with self._journal.open("a") as file:
            file.write(f"{self.clock.now_s()} {event} 0 0 0\n")

    def open(self):
        self.note("identify")
        identities = {"left_knee_joint": KNEE_SERIAL}
        if "FAKE_WIRE_SERIAL" in os.environ:
            identities["bus fake"] = os.environ["FAKE_WIRE_SERIAL"]
        return replace(super().open(), identities=identities)

    def write(self, command):
        self.note("TRACK")
        super().write(command)

    def close(self):
        if self._is_open:
            self.note("close")
        super().close()


@pytest.fixture
def no_wire(rig, monkeypatch):
    """Runs of a real wire with the device in this process, in simulated time: here it matters who may start."""

    def open_backend(name, robot, clock, *, control_period_s, **others):
        return Journalled(robot, clock, control_period_s, rig.folder / "journal")

    monkeypatch.setattr("deploy.session.open_backend", open_backend)
    monkeypatch.setattr("deploy.session.MonotonicClock", SimulatedClock)
    monkeypatch.setattr("deploy.session.realtime", lambda say: contextlib.nullcontext())
    monkeypatch.setattr("deploy.dry_run.time", SimpleNamespace(perf_counter=lambda: 0.0))


def events(rig):
    return [row[1] for row in read_journal(rig.folder / "journal")]


def test_a_dry_run_reads_infers_writes_nothing_and_is_recorded(rig, capsys):
    assert rig("--dry-run", "--json", rig.folder / "r.json") == 0
    out = capsys.readouterr().out
    assert set(events(rig)) == {"identify", "close"}
    assert "dry run, nothing was written" in out and "dry run: actor clip" in out and "recorded " in out
    result = json.loads((rig.folder / "r.json").read_text())
    assert result["outcome"] == "completed" and result["timing"]["ticks"] > 50 and result["emulated"] is False
    assert result["wire"]["cycles"]["fake"]["rounds"] > 0
    (record,) = (rig.folder / "records").iterdir()
    assert json.loads(record.read_text())["valid_for"]["policy"] == result["policy_sha256"]


def test_the_first_run_needs_a_passed_dry_run(rig, no_wire, capsys):
    assert rig("--duration", 0.2) == 2
    error = capsys.readouterr().err
    assert "no dry run has passed" in error and "--dry-run" in error and events(rig) == []
    assert rig("--duration", 0.2, "--first-run-ok") == 0
    assert rig("--dry-run") == 0
    assert rig("--duration", 0.2) == 0
    (rig.folder / "wire.yaml").write_text("a: 2\n")
    assert rig("--duration", 0.2) == 2


def test_a_robot_that_nobody_has_verified_is_refused(rig, no_wire, capsys):
    """By which motor it is another; --first-run-ok and a dry run, which moves nothing, go on all the same."""
    assert rig("--dry-run") == 0
    assert rig("--duration", 0.2) == 0
    rig.verify("another number")
    assert rig("--duration", 0.2) == 4
    error = capsys.readouterr().err
    assert f"left_knee_joint is {KNEE_SERIAL}, verified was another number: run hal/verify" in error
    (rig.folder / "verified").rename(rig.folder / "forgotten")
    assert rig("--duration", 0.2) == 4
    assert (
        "verified: not verified with this configuration: hang the robot up and run hal/verify"
        in capsys.readouterr().err
    )
    assert "TRACK" not in events(rig)
    assert rig("--dry-run") == 0
    assert rig("--duration", 0.2, "--first-run-ok") == 0


def test_a_real_wire_waits_for_its_operator(rig, capsys):
    """Nothing but the end of the run moves it: no STAND_UP by itself."""
    assert rig("--duration", 1.0, "--first-run-ok") == 0
    out = capsys.readouterr().out
    assert "STAND_UP" not in out.replace("possible in", "").splitlines() and "s stand up" in out
    assert "TRACK" not in events(rig)


def test_a_remote_without_consent_touches_nothing(rig, capsys, monkeypatch):
    """B is held: the robot may stand by its own controller, and would fall."""
    real = hal.open.wire_factory
    monkeypatch.setattr(hal.open, "wire_factory", lambda name, config, endpoints: real(name, config, {"B": ""}))
    assert rig("--duration", 0.5, "--first-run-ok") == 0
    assert set(events(rig)) == {"identify", "close"}
    assert capsys.readouterr().err.count("damp refused: the robot may stand by its own controller") == 1


class Typist(threading.Thread):
    """Somebody at the terminal, who types the next text when the device's journal shows what it waits for."""

    def __init__(self, rig, *steps):
        super().__init__(daemon=True)
        self.master, self.slave = pty.openpty()
        self.rig, self.steps, self.seen = rig, steps, []

    def run(self):
        while termios.tcgetattr(self.slave)[3] & termios.ICANON:
            time.sleep(0.02)
        time.sleep(0.5)  # the loop begins: keys that wait together would be taken for pasted ones
        for text, awaited in self.steps:
            for key in [text] if len(text) > 1 and text != "take\n" else text:
                os.write(self.master, key.encode())
                time.sleep(0.06)
            end_s = time.monotonic() + 10.0
            while awaited and awaited not in events(self.rig) and time.monotonic() < end_s:
                time.sleep(0.02)
            self.seen.append(set(events(self.rig)) - {"identify", "close"})


@pytest.mark.real_time
def test_a_robot_is_taken_by_a_typed_word_and_by_nothing_less(rig, capsys, monkeypatch):
    typist = Typist(
        rig,
        *((text, None) for text in ("s", "d", " ", "ls -la", "start the motion", "\x1b[8;24;80t", "s", "no\n", "s")),
        ("take\n", None),
        ("\x1b[8;24;80t", None),
        ("s", "TRACK"),
        ("q", None),
    )
    monkeypatch.setattr("deploy.operator.keyboard._standard_input", lambda: typist.slave)
    typist.start()
    assert rig("--first-run-ok") == 0
    typist.join(5.0)
    assert typist.seen[:-2] == [set()] * 11 and {"DAMP", "TRACK"} <= typist.seen[-2]
    assert "STAND_UP" in capsys.readouterr().out


def answer_then(typist, at_the_end):
    """What shows the typist's terminal says that all is well, as long as the typist types."""
    while typist.is_alive():
        if select.select([typist.master], [], [], 0.05)[0]:
            os.write(typist.master, WELL * os.read(typist.master, 4096).count(ASK))
    at_the_end()


def stop_when_damped_again(rig):
    """Ends the run when the device has been told to damp after it was driven; a run without such an end takes 10 s."""
    wait_until(lambda: "TRACK" in events(rig) and events(rig)[-1] == "DAMP", 20.0)
    os.kill(os.getpid(), signal.SIGTERM)


@pytest.mark.real_time
@pytest.mark.parametrize("end", ["closed", "stalled"])
def test_a_robot_whose_operator_is_lost_is_damped_after_the_configured_time(rig, capsys, monkeypatch, end):
    """The terminal closes or falls silent while the robot is driven; the device sees damping 1 s later, not before."""
    settings = yaml.safe_load((rig.folder / "patient.yaml").read_text())
    times = {"terminal_silent_s": 0.6, "hold_after_s": 0.2, "lower_after_s": 0.4}
    settings["operator"] |= times if end == "stalled" else {"hold_after_s": 0.2, "lower_after_s": 1.0}
    (rig.folder / "patient.yaml").write_text(yaml.safe_dump(settings))
    monkeypatch.setattr(WireBackend, "remote", lambda backend: ((), math.inf))
    typist = Typist(rig, ("s", None), ("take\n", None), ("s", "TRACK"))
    monkeypatch.setattr("deploy.operator.keyboard._standard_input", lambda: typist.slave)
    typist.start()
    at_the_end = (lambda: None) if end == "stalled" else (lambda: os.close(typist.master))
    threading.Thread(target=answer_then, args=(typist, at_the_end)).start()
    threading.Thread(target=stop_when_damped_again, args=(rig,)).start()
    assert rig("--first-run-ok", "--duration", 10.0) == 0
    error = capsys.readouterr().err
    assert "operator lost: no live stop source (had: keyboard, remote)" in error
    rows = [row for row in read_journal(rig.folder / "journal") if row[1] in ("TRACK", "DAMP")]
    driven = [row[0] for row in rows if row[1] == "TRACK"]
    assert rows[-1][1] == "DAMP" and 0.8 < driven[-1] - driven[0] < 3.0


@pytest.mark.real_time
def test_a_log_holds_the_remote_the_wires_counters_and_the_wall_clock(rig, monkeypatch):
    real = hal.open.wire_factory
    monkeypatch.setattr(hal.open, "wire_factory", lambda name, config, endpoints: real(name, config, {"A": ""}))
    assert rig("--duration", 1.5, "--first-run-ok", "--log", rig.folder / "logs") == 0
    (path,) = (rig.folder / "logs").iterdir()
    said = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            said.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
    assert {tuple(content["buttons"]) for _, content in said["/remote"]} == {("A",)}
    assert all(0.0 <= content["age_s"] < 1.0 for _, content in said["/remote"])
    rounds = [content["cycles"]["fake"]["rounds"] for _, content in said["/wire"]]
    assert rounds == sorted(rounds) and rounds[-1] > 100 and said["/wire"][-1][1]["stats"] == {"published": 1.0}
    (first_ns, first), (last_ns, last) = said["/clock"][0], said["/clock"][-1]
    assert abs(last["unix_s"] - time.time()) < 60.0
    assert last["unix_s"] - first["unix_s"] == pytest.approx(1e-9 * (last_ns - first_ns), abs=0.2)


@pytest.mark.parametrize(
    ("phase", "number"), [("opening", signal.SIGTERM), ("preflight", signal.SIGINT), ("preflight", signal.SIGHUP)]
)
def test_a_signal_before_anything_is_energised_stops_within_5_s(rig, capsys, monkeypatch, number, phase):
    how = {"identify_s": 60.0} if phase == "opening" else {"mute": True}
    monkeypatch.setenv("FAKE_WIRE", json.dumps(how))
    settings = yaml.safe_load(patient_settings())
    settings["preflight"]["state_wait_s"] = 60.0
    (rig.folder / "patient.yaml").write_text(yaml.safe_dump(settings))
    stopped_s = []

    def stop():
        wait_until(lambda: "identify" in events(rig))
        time.sleep(0.5)
        stopped_s.append(time.monotonic())
        os.kill(os.getpid(), number)

    stopping = threading.Thread(target=stop)
    stopping.start()
    assert rig("--dry-run") == 0
    stopping.join()
    assert time.monotonic() - stopped_s[0] < 5.0
    assert "stopped before anything was commanded" in capsys.readouterr().out
    assert set(events(rig)) <= {"identify", "close"}


def test_every_line_of_a_run_with_a_simulator_says_so(rig, capfd, monkeypatch):
    """The wire's driver is the fake, which knows no peer; what is shown is the run's own output."""
    monkeypatch.setattr(RunOptions, "_check_wire", lambda self: None)
    assert rig("--dry-run", "--peer", "simulator") == 0
    said = capfd.readouterr()
    lines = (said.out + said.err).splitlines()
    label = "[peer simulator: checksum, mode_machine, tick and rate are not checked] "
    assert len(lines) > 10 and all(line.startswith((label, "wire can, peer simulator: ")) for line in lines)


BAD = [
    ((), {"emulate": True}, "--emulate and --first-run-ok, got --backend mock"),
    ((), {"first_run_ok": True}, "--first-run-ok"),
    ((), {"faults": ("silence",)}, "--fault"),
    ((), {"interface": "lo"}, "--interface and --domain"),
    (("can",), {"domain": 1}, "--interface and --domain, got --backend can"),
    (("dds",), {"domain": 1, "emulate": True}, "got --backend dds with --emulate"),
    (("can",), {"hand_back": True}, "--hand-back, got --backend can"),
    (("can",), {"peer": "simulator"}, "--peer, got --backend can"),
    (("can",), {"realtime": False}, "--fast"),
    (("mujoco",), {"hal_config": "mock"}, "--hal-config"),
    (("can",), {"start_noise_rad": 0.1}, "--start-noise"),
    (("mujoco",), {"gamepad": "js0"}, "--gamepad"),
]


@pytest.mark.parametrize(("backend", "options", "says"), BAD, ids=[row[2] for row in BAD])
def test_options_that_do_not_fit(backend, options, says):
    with pytest.raises(InputError, match=says):
        RunOptions(*(backend or ("mock",)), ("taichi",), **options).check()


def test_reference_start_needs_a_simulation(rig, capsys):
    assert rig("--start", "reference", "--emulate") == 2
    assert "--start reference" in capsys.readouterr().err


def test_start_noise_is_for_the_emulator():
    RunOptions("can", ("taichi",), emulate=True, start_noise_rad=0.02).check()


def changed_stand(rig):
    write_standing_actor(rig.folder / "stand.onnx", name="another_stand")


def changed_settings(rig):
    patient = rig.folder / "patient.yaml"
    patient.write_text(patient.read_text().replace("blend_s: 0.3", "blend_s: 0.4"))


@pytest.mark.parametrize(("change", "what"), [(changed_stand, "stand"), (changed_settings, "settings")])
def test_a_dry_run_with_another_stand_or_other_thresholds_does_not_hold(rig, no_wire, capsys, change, what):
    assert rig("--dry-run") == 0 and rig("--duration", 0.2) == 0
    change(rig)
    assert rig("--duration", 0.2) == 2
    assert f"since the dry run that passed, these changed: {what}; run the same" in capsys.readouterr().err


def test_a_dry_run_of_another_robot_does_not_hold(rig, no_wire, capsys, monkeypatch):
    """The same files and the same code; only the numbers that the makers gave the motors differ."""
    monkeypatch.setenv("FAKE_WIRE_SERIAL", "motor 1")
    rig.verify(KNEE_SERIAL, {"bus fake": "motor 1"})
    assert rig("--dry-run") == 0 and rig("--duration", 0.2) == 0
    monkeypatch.setenv("FAKE_WIRE_SERIAL", "motor 2")
    assert rig("--duration", 0.2) == 2
    assert "these changed: identity; run" in capsys.readouterr().err
    assert "TRACK" not in events(rig) and events(rig)[-1] == "close"


RECORD = DryRunRecord("a" * 64, "clip", "stand", "settings", "robot", "b" * 64, "v1", "id")


@pytest.mark.parametrize("field", [field.name for field in fields(DryRunRecord)])
def test_records_are_compared_whole(tmp_path, field):
    assert "no dry run" in RECORD.missing(tmp_path, 7.0)
    RECORD.save(tmp_path / "new", {"backend": "can"})
    assert RECORD.missing(tmp_path / "new", 7.0) is None
    assert replace(RECORD, identity=None).missing(tmp_path / "new", 7.0) is None
    other = replace(RECORD, **{field: "c" * 64})
    assert field in other.missing(tmp_path / "new", 7.0) or "no dry run" in other.missing(tmp_path / "new", 7.0)


@pytest.mark.parametrize(("age_days", "holds"), [(6.9, True), (7.1, False), (-1.0, False)])
def test_a_record_expires(tmp_path, age_days, holds):
    path = RECORD.save(tmp_path, {})
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"passed_unix_s": time.time() - age_days * DAY_S}))
    why = RECORD.missing(tmp_path, 7.0)
    assert (why is None) is holds and (holds or f"is {age_days:.1f} days old, limit 7" in why)


def test_policies_without_a_record_are_named(tmp_path):
    with pytest.raises(InputError, match="policy x, y: no dry run has passed with this HAL configuration"):
        require_records([("x", RECORD), ("y", RECORD)], tmp_path, 7.0)
