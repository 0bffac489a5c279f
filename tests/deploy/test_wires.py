"""deploy/run on a wire: who may start, what a dry run writes, what is recorded. The wire's driver is a fake."""

import json

import pytest
import yaml

import deploy.session
import hal.open
from core.config import config_file
from core.errors import InputError
from deploy.cli import main
from deploy.dry_run import DryRunRecord, require_records
from deploy.options import RunOptions
from tests.deploy.toys import write_standing_actor
from tests.hal.wire.fake import read_journal


def patient_settings():
    """The defaults, but a machine that pauses for a second trips nothing: what trips is tests/hal/conformance's."""
    settings = yaml.safe_load(config_file("deploy", "default").read_text())
    settings["safety"]["stale"] = {"limit_periods": 50.0, "trip_periods": 50.0}
    settings["preflight"] |= {"age_periods": 50.0, "dry_run_overruns": 1.0}
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
    monkeypatch.setenv("FAKE_WIRE_JOURNAL", str(tmp_path / "journal"))

    def run(*options):
        common = ["--policy", str(tmp_path / "clip.onnx"), "--stand", str(tmp_path / "stand.onnx")]
        common += ["--config", str(tmp_path / "patient.yaml")]
        return main(["--backend", "can", *common, *map(str, options)])

    run.folder = tmp_path
    return run


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
    assert json.loads(record.read_text())["policy_sha256"] == result["policy_sha256"]


def test_the_first_run_needs_a_passed_dry_run(rig, capsys):
    assert rig("--duration", 0.2) == 2
    error = capsys.readouterr().err
    assert "no passed dry run" in error and "--dry-run" in error and events(rig) == []
    assert rig("--duration", 0.2, "--first-run-ok") == 0
    assert rig("--dry-run") == 0
    assert rig("--duration", 0.2) == 0
    (rig.folder / "wire.yaml").write_text("a: 2\n")
    assert rig("--duration", 0.2) == 2


def test_a_real_wire_waits_for_its_operator(rig, capsys):
    """Nothing but the end of the run moves it: no STAND_UP by itself."""
    assert rig("--duration", 1.0, "--first-run-ok") == 0
    out = capsys.readouterr().out
    assert "STAND_UP" not in out.replace("possible in", "").splitlines() and "s stand up" in out
    assert "TRACK" not in events(rig)


def test_the_remote_stops_it(rig, capsys, monkeypatch):
    real = hal.open.wire_factory
    monkeypatch.setattr(hal.open, "wire_factory", lambda name, config, endpoints: real(name, config, {"B": ""}))
    assert rig("--duration", 0.5, "--first-run-ok") == 0
    assert "damping" in capsys.readouterr().out.splitlines()
    assert "DAMP" in events(rig)


def test_every_line_of_a_run_with_a_simulator_says_so(rig, capfd, monkeypatch):
    """The wire's driver is the fake, which knows no peer; what is shown is the run's own output."""
    monkeypatch.setattr(RunOptions, "_check_wire", lambda self: None)
    assert rig("--dry-run", "--peer", "simulator") == 0
    said = capfd.readouterr()
    lines = (said.out + said.err).splitlines()
    label = "[peer simulator: checksum, mode_machine and tick are not checked] "
    assert len(lines) > 10 and all(line.startswith((label, "wire can, peer simulator: ")) for line in lines)


BAD = [
    ((), {"emulate": True}, "--emulate and --first-run-ok, got --backend mock"),
    ((), {"first_run_ok": True}, "--first-run-ok"),
    ((), {"faults": ("silence",)}, "--fault"),
    ((), {"interface": "lo"}, "--interface and --domain"),
    (("can",), {"domain": 1}, "--interface and --domain, got --backend can"),
    (("dds",), {"domain": 1, "emulate": True}, "got --backend dds with --emulate"),
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


def test_records_are_compared_whole(tmp_path):
    record = DryRunRecord("a" * 64, "b" * 64)
    assert not record.is_saved(tmp_path)
    record.save(tmp_path / "new", {"backend": "can"})
    assert record.is_saved(tmp_path / "new")
    assert not DryRunRecord("a" * 63 + "c", "b" * 64).is_saved(tmp_path / "new")
    with pytest.raises(InputError, match="policy x, y with this HAL configuration: no passed dry run"):
        require_records([("x", record), ("y", record)], tmp_path)
