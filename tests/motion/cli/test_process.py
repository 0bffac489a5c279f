"""The command motion/process: what it writes, what it refuses, and its exit codes."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from motion import pipeline
from motion.cli.process import main
from motion.clip import load_clip, save_clip
from motion.clip_set import open_clip_set
from motion.library import CLIPS
from motion.report.record import CREATED_BY
from robot.robot import load_robot


@pytest.fixture(autouse=True)
def light(monkeypatch, tmp_path):
    """Works in an empty folder; pages are small and plainly drawn."""
    monkeypatch.setenv("KATA_RENDERER", "software")
    monkeypatch.setattr("motion.report.page.STRIP_SIZE_PX", 32)
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def no_page(monkeypatch):
    monkeypatch.setattr("motion.report.page.report_page", lambda record: f"page of {record.name}")


def held(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def floating(standing_clip, num_frames=61):
    return standing_clip(
        num_frames, root_pos_w=np.tile([0.0, 0.0, 1.8], (num_frames, 1)), contact=np.zeros((num_frames, 2))
    )


def test_a_clip_with_its_report(standing_clip, tmp_path, no_page, capsys):
    save_clip(standing_clip(), tmp_path / "still.npz")
    assert main(["--input", str(tmp_path / "still.npz")]) == 0
    folder = tmp_path / "motions" / "still"
    assert held(folder) == ["report.html", "report.json", "still.npz"]
    told = json.loads((folder / "report.json").read_text())
    assert told["verdict"] == "trackable" and told["created_by"] == CREATED_BY
    content = (tmp_path / "still.npz").read_bytes()
    assert told["input"]["file"] == "still.npz" and told["input"]["sha256"] == hashlib.sha256(content).hexdigest()
    assert told["clip"]["sha256"] == load_clip(folder / "still.npz").sha256
    assert (folder / "report.html").read_text() == "page of still"
    said = capsys.readouterr().out.splitlines()
    assert all(line.startswith("still: ") for line in said) and said[-1] == "still: trackable, motions/still"


def test_a_motion_that_cannot_be_followed(standing_clip, tmp_path, no_page, capsys):
    save_clip(floating(standing_clip), tmp_path / "high.npz")
    assert main(["--input", "high.npz", "--output", "out"]) == 1
    assert held(tmp_path / "out") == ["high.npz", "report.html", "report.json"]
    told = json.loads((tmp_path / "out" / "report.json").read_text())
    assert told["verdict"] == "not trackable" and len(told["failing_frames"]["input"]) == 61
    for reason in told["reasons"]:
        assert f"high:   {reason}" in capsys.readouterr().out
        break
    assert main(["--input", "high.npz", "--output", "out", "--end", "1", "--loop"]) == 1  # too short for a loop
    assert held(tmp_path / "out") == ["report.html", "report.json"]


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        (None, [], "no such file"),
        (b"", [], "empty file"),
        (b"PK\x03\x04 half a file", [], "damaged"),
        (b"HIERARCHY\nROOT Hips\n{", [], ""),
        (b"1,2,3\n", [], "wrong number of columns"),
        (b",".join([b"nan"] * 36) + b"\n" + b",".join([b"0"] * 36), [], "not finite"),
        (b",".join([b"0"] * 36), [], "too few frames"),
        ("clip", ["--fps", "0"], "expected a number above 0"),
        ("clip", ["--fps", "1e9"], "out of range"),
        ("clip", ["--start", "99"], "times outside the motion"),
        ("clip", ["--start", "2", "--end", "1"], "nothing is left"),
        ("clip", ["--loop"], "given.npz: too short to loop"),
        ("clip", ["--name", "a/b"], "cannot be a clip's name"),
        ("clip", ["--name", ".."], "cannot be a clip's name"),
        ("clip", ["--name", ""], "--name: cannot be a clip's name, got ''"),
        ("clip", ["--name", "é" * 101], "--name: too long for a clip's name, got 202 bytes, expected at most 200"),
        ("clip", ["--unit", "cm", "--up", "z"], "given.npz: kata clip has no use for --unit, --up; leave it out"),
        ("clip", ["--skeleton", "none.yaml"], "given.npz: kata clip has no use for --skeleton"),
        ("clip", ["--start", "1", "--end", "1.01"], "given.npz: too few frames"),
        ("clip", ["--robot", "nobody"], "unknown robot"),
        ("clip", ["--output", "no/such"], "no such folder"),
        ("clip", ["--output", "."], "folder is in use"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(standing_clip, tmp_path, capsys, content, options, message):
    path = tmp_path / "given.npz"
    if content == "clip":
        save_clip(standing_clip(), path)
    elif content is not None:
        path = tmp_path / "given.csv"
        path.write_bytes(content)
    before = held(tmp_path)
    assert main(["--input", str(path), *options]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and message in error
    assert held(tmp_path) == before


def test_results_are_replaced_and_other_things_are_not(standing_clip, tmp_path, no_page, capsys):
    save_clip(standing_clip(), "a.npz")
    assert [main(["--input", "a.npz"]), main(["--input", "a.npz", "--mirror"])] == [0, 0]
    assert json.loads((tmp_path / "motions/a/report.json").read_text())["options"] == {"mirror": True}
    (tmp_path / "motions/a/mine.txt").write_text("mine")
    assert main(["--input", "a.npz"]) == 2
    assert "folder is in use" in capsys.readouterr().err
    assert held(tmp_path / "motions/a") == ["a.npz", "mine.txt", "report.html", "report.json"]


def test_one_bad_input_of_several_stops_nobody(standing_clip, tmp_path, capfd):
    save_clip(standing_clip(), "good.npz")
    (tmp_path / "bad.csv").write_text("hello")
    good = str(tmp_path / "good.npz")
    assert main(["--input", "bad.csv", good, "--input", "missing.bvh", "--jobs", "2", "--output", "out"]) == 2
    results = ["good", "good/good.npz", "good/report.html", "good/report.json"]
    assert held(tmp_path / "out") == ["clips.yaml", *results]
    told = capfd.readouterr()
    assert told.err.count("error: ") == 2 and "good: trackable" in told.out
    page = (tmp_path / "out" / "good" / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 6
    for text in (page, (tmp_path / "out" / "good" / "report.json").read_text()):
        assert str(tmp_path) not in text


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--input", "a.npz", "b/a.csv"], "inputs of one name, got a"),
        (["--input", "a.npz", "b.npz", "--name", "c"], "one name for several inputs"),
        (["--input", "a.npz", "--jobs", "0"], "expected a whole number from 1 up"),
        ([], "--input"),
    ],
)
def test_contradicting_options(options, message, capsys, tmp_path):
    assert main(options) == 2
    assert message in capsys.readouterr().err
    assert held(tmp_path) == []


@pytest.fixture
def recordings(standing_clip, tmp_path):
    """A folder with two motions that can be followed, in two folders, and one that cannot."""
    (tmp_path / "all" / "deep").mkdir(parents=True)
    for name, clip in (("a", standing_clip()), ("deep/a", standing_clip(70)), ("deep/high", floating(standing_clip))):
        save_clip(clip, tmp_path / "all" / f"{name}.npz")
    (tmp_path / "all" / "notes.txt").write_text("not a motion")
    return tmp_path / "all"


@pytest.fixture
def here(monkeypatch):
    """Work in the test's process; work in several is tested with one bad input of several, and in test_parallel."""
    monkeypatch.setattr("motion.cli.process.run_all", lambda work, jobs, workers: [work(job) for job in jobs])


def test_a_folder_becomes_a_clip_set(recordings, tmp_path, no_page, here, capsys):
    assert main(["--input", "all", "--output", "set", "--licence", "CC BY 4.0, someone", "--jobs", "1"]) == 1
    assert "set/clips.yaml: 2 of 3 clips are trackable" in capsys.readouterr().out
    names = [(named.name, named.clip.license) for named in open_clip_set(tmp_path / "set", load_robot())]
    assert names == [("a", "CC BY 4.0, someone"), ("deep_a", "CC BY 4.0, someone")]


def test_a_folder_that_was_left_half_done_goes_on(recordings, tmp_path, no_page, here, monkeypatch, capsys):
    done = []
    monkeypatch.setattr(
        "motion.cli.process.process", lambda request, say: done.append(request.name) or pipeline.process(request, say)
    )
    assert main(["--input", "all", "--output", "set"]) == 1
    assert done == ["a", "deep_a", "deep_high"]
    before = (tmp_path / "set" / "clips.yaml").read_bytes()
    shutil.rmtree(tmp_path / "set" / "deep_a")
    save_clip(load_clip(recordings / "deep" / "a.npz"), recordings / "a.npz")  # another file now
    done.clear()
    capsys.readouterr()
    assert main(["--input", "all", "--output", "set"]) == 1
    assert done == ["a", "deep_a"]
    assert "deep_high: not trackable, done already" in capsys.readouterr().out
    assert (tmp_path / "set" / "clips.yaml").read_bytes() != before  # the clip of a is another one
    done.clear()
    assert main(["--input", "all", "--output", "set", "--mirror"]) == 1
    assert done == ["a", "deep_a", "deep_high"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--input", "all", "--output", "all/set"], "results among the inputs"),
        (["--input", "all", "all/a.npz"], "a folder with other inputs, or a name"),
        (["--input", "all", "--name", "x"], "a folder with other inputs, or a name"),
        (["--input", "empty"], "no motion file"),
        (["--input", "all/a.npz", "--licence", "mine"], "--licence: is said of a folder's motions"),
        (["--input", "odd"], "odd/-a.npz: cannot be a clip's name"),
        (["--input", "stand"], f"--input: no such file, got stand; for the clip that comes with kata: --input {CLIPS}"),
    ],
)
def test_folders_that_are_no_use_are_refused(recordings, tmp_path, options, said, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "odd").mkdir()
    shutil.copy(recordings / "a.npz", tmp_path / "odd" / "-a.npz")
    before = held(tmp_path)
    assert main(options) == 2
    assert said in capsys.readouterr().err and held(tmp_path) == before


def test_a_folder_without_a_trackable_motion_has_no_manifest(standing_clip, tmp_path, no_page, capsys):
    (tmp_path / "all").mkdir()
    save_clip(floating(standing_clip), tmp_path / "all" / "high.npz")
    assert main(["--input", "all", "--output", "set"]) == 1
    assert capsys.readouterr().out.endswith("set: no clip is trackable, see the report.html of each\n")
    assert not (tmp_path / "set" / "clips.yaml").exists()


def listed(manifest):
    return {Path(clip["file"]).stem: clip for clip in yaml.safe_load(manifest.read_text())["clips"]}


def test_the_manifest_lists_every_result_that_lies_beside_it(recordings, standing_clip, tmp_path, no_page, here):
    """Of one file, of several, and of two folders; what a person wrote into it stays."""
    manifest = tmp_path / "motions" / "clips.yaml"
    shutil.copy(recordings / "a.npz", tmp_path / "one.npz")
    assert main(["--input", "one.npz"]) == 0 and list(listed(manifest)) == ["one"]
    assert [clip.name for clip in open_clip_set("motions", load_robot())] == ["one"]
    assert main(["--input", "all", "--licence", "CC0"]) == 1 and list(listed(manifest)) == ["a", "deep_a", "one"]
    manifest.write_text(manifest.read_text() + "  split: test\n- file: /elsewhere/b.npz\n- file: ../one.npz\n")
    manifest.write_text(manifest.read_text().replace("../one", "../all/deep/high"))
    (tmp_path / "more").mkdir()
    shutil.copy(recordings / "a.npz", tmp_path / "more" / "c.npz")
    assert main(["--input", "more", "--licence", "CC BY 4.0"]) == 0
    assert {name: clip.get("licence") for name, clip in listed(manifest).items()} == {
        "a": "CC0", "c": "CC BY 4.0", "deep_a": "CC0", "high": None, "one": None,
    }  # fmt: skip
    assert listed(manifest)["one"]["split"] == "test"
    assert main(["--input", "one.npz", "--mirror", "--output", "motions/one"]) == 0
    content = (tmp_path / "motions" / "one" / "one.npz").read_bytes()
    assert listed(manifest)["one"]["sha256"] == hashlib.sha256(content).hexdigest()
    save_clip(floating(standing_clip), tmp_path / "more" / "c.npz")
    assert main(["--input", "more"]) == 1 and "c" not in listed(manifest)
    for name in ("a", "deep_a", "one"):
        shutil.rmtree(tmp_path / "motions" / name)
    manifest.write_text("clips:\n- file: a/a.npz\n")
    assert main(["--input", "more"]) == 1 and not manifest.exists()


def test_capital_endings_are_read_and_hidden_files_are_not(recordings, tmp_path, no_page, here):
    (recordings / "a.npz").rename(recordings / "A.NPZ")
    (recordings / "._b.npz").write_bytes(b"what macOS leaves")
    (recordings / ".cache").mkdir()
    (recordings / ".cache" / "c.npz").write_bytes(b"not meant")
    assert main(["--input", "all", "--output", "set"]) == 1
    assert list(listed(tmp_path / "set" / "clips.yaml")) == ["A", "deep_a"]


def test_another_skeleton_or_body_model_is_another_setting(tmp_path):
    (tmp_path / "my.yaml").write_text("first")
    (tmp_path / "models" / "smplx").mkdir(parents=True)
    request = pipeline.ProcessRequest(
        Path("a.bvh"), "a", skeleton=tmp_path / "my.yaml", body_models=tmp_path / "models"
    )
    found = [request.settings_sha256()]
    for path in ("my.yaml", "models/smplx/SMPLX_NEUTRAL.npz"):
        (tmp_path / path).write_text("another")
        found.append(request.settings_sha256())
    assert len(set(found)) == 3 and request.settings_sha256() == found[-1]
