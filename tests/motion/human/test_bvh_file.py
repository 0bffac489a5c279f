"""The parser of BVH files: what it takes from small files, and the line it names in wrong ones."""

import tracemalloc

import numpy as np
import pytest

from core.errors import InputError
from motion.frames import MAX_FRAMES
from motion.human.bvh_file import MAX_JOINTS, MAX_LINE, parse_bvh

SMALL = """HIERARCHY
ROOT Hips
{
\tOFFSET 1.0 2.0 3.0
\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
\tJOINT Left Leg {
\t\tOFFSET 0 -4.5e1 0
\t\tCHANNELS 1 XROTATION
\t\tEnd Site toe
\t\t{ OFFSET 0 0 7 }
\t}
}
MOTION
Frames: 2
Frame Time:\t0.0333330
1 2 3 4 5 6 7
-1 -2 -3 -4 -5 -6 -7

"""


def test_what_a_file_holds():
    bvh = parse_bvh(SMALL.encode(), "a.bvh")
    names = [(joint.name, joint.parent, joint.offset, len(joint.channels), joint.first) for joint in bvh.joints]
    assert names == [
        ("Hips", -1, (1.0, 2.0, 3.0), 6, 0),
        ("Left Leg", 0, (0.0, -45.0, 0.0), 1, 6),
        ("Left Leg/end", 1, (0.0, 0.0, 7.0), 0, 0),
    ]
    assert bvh.joints[0].channels[3:] == ("zrotation", "xrotation", "yrotation")
    np.testing.assert_array_equal(bvh.values, [[1, 2, 3, 4, 5, 6, 7], [-1, -2, -3, -4, -5, -6, -7]])
    assert bvh.frame_time_text == "0.0333330"


@pytest.mark.parametrize("content", [b"\xef\xbb\xbf" + SMALL.encode(), SMALL.replace("\n", "\r\n").encode()])
def test_byte_order_mark_and_line_ends(content):
    assert parse_bvh(content, "a.bvh").values.shape == (2, 7)


WRONG = {
    "no hierarchy": (("HIERARCHY", "MOTION"), r"line 1: unexpected word, got 'MOTION', expected HIERARCHY"),
    "offset of two": (("OFFSET 1.0 2.0 3.0", "OFFSET 1.0 2.0"), r"line 5: not a number, got 'CHANNELS'"),
    "nan offset": (("1.0 2.0 3.0", "1.0 nan 3.0"), r"line 4: not a number, got 'nan', expected three offsets"),
    "channel": (("Zrotation", "Wrotation"), r"line 5: wrong channel, got 'wrotation'"),
    "channel twice": (("Zrotation", "Xposition"), r"line 5: wrong channel, got 'xposition'"),
    "channels": (("CHANNELS 1", "CHANNELS 7"), r"line 8: wrong number of channels, got 7, expected 0 to 6"),
    "half a channel": (("CHANNELS 1", "CHANNELS 1.5"), r"line 8: wrong number of channels"),
    "channels twice": (("\tJOINT", "CHANNELS 1 Xrotation\n\tJOINT"), r"line 6: unexpected word, got 'channels'"),
    "name twice": (("Left Leg", "Hips"), r"line 6: joint appears twice, got Hips"),
    "child of an end": (("{ OFFSET 0 0 7 }", "{ JOINT x { } }"), r"line 10: unexpected word, got 'joint'"),
    "brace": (("\t}\n}\nMOTION", "\t}\nMOTION"), r"line 12: unexpected word, got 'motion'"),
    "one brace more": (("}\nMOTION", "}\n}\nMOTION"), r"line 13: unexpected word, got '}', expected MOTION"),
    "frames word": (("Frames: 2", "Frames: two"), r"line 14: not a number, got 'two'"),
    "half a frame": (("Frames: 2", "Frames: 1.5"), r"line 14: impossible number, got 1.5"),
    "endless frames": (("Frames: 2", "Frames: 1e300"), r"line 14: impossible number, got 1e\+300"),
    "negative frames": (("Frames: 2", "Frames: -2"), r"Frames: too few frames, got -2"),
    "one frame": (("Frames: 2", "Frames: 1"), r"Frames: too few frames, got 1, expected 2 or more"),
    "too many frames": (("Frames: 2", f"Frames: {MAX_FRAMES + 1}"), r"Frames: too long, got 100001 frames"),
    "more frames stated": (("Frames: 2", "Frames: 3"), r"number of frames differs, got 2 lines .*, expected 3"),
    "more frames there": (("-1 -2", "1 2 3 4 5 6 7\n-1 -2"), r"number of frames differs, got 3 lines"),
    "frame time": (("0.0333330", "fast"), r"line 15: not a number, got 'fast'"),
    "words behind": (("0.0333330", "0.0333330 s"), r"line 15: unexpected word, got 's', expected a frame"),
    "value missing": (("5 6 7\n", "5 6\n"), r"line 16: wrong number of values, got 6, expected 7"),
    "value": (("-6 -7", "-6 x7"), r"line 17: not a number, got 'x7'"),
    "nan": (("-6 -7", "-6 NaN"), r"line 17: not a number, got 'NaN'"),
    "infinite": (("-6 -7", "-6 1e999"), r"line 17: not a number, got '1e999'"),
    "underscore": (("-6 -7", "-6 1_0"), r"line 17: not a number, got '1_0'"),
    "long line": (("-6 -7", "-6 -7 " + "0 " * MAX_LINE), r"line 17: line too long"),
}


@pytest.mark.parametrize(("change", "message"), WRONG.values(), ids=WRONG)
def test_errors_name_the_line(change, message):
    assert change[0] in SMALL
    with pytest.raises(InputError, match=rf"^a\.bvh(: {message}|: line \d+: {message})"):
        parse_bvh(SMALL.replace(*change, 1).encode(), "a.bvh")


def test_every_truncation_is_one_error():
    for length in range(len(SMALL.rstrip()) - 3):
        with pytest.raises(InputError) as caught:
            parse_bvh(SMALL[:length].encode(), "cut.bvh")
        assert str(caught.value).startswith("cut.bvh: ") and "\n" not in str(caught.value)


def test_no_text():
    with pytest.raises(InputError, match=r"a\.bvh: is not text"):
        parse_bvh(b"HIERARCHY\n\xff\xfe", "a.bvh")


HUGE = {
    "depth": "HIERARCHY\nROOT a\n{\n" + "".join(f"JOINT b{i}\n{{\n" for i in range(50_000)),
    "braces": "HIERARCHY\nROOT a\n" + "{" * 2_000_000,
    "name": "HIERARCHY\nROOT " + "a " * 40_000,
    "joints": "HIERARCHY\nROOT a\n{\n" + "".join(f"JOINT b{i}\n{{\n}}\n" for i in range(MAX_JOINTS)),
    "lines": "HIERARCHY" + "\n" * 3_000_000,
    "stated frames": SMALL.replace("Frames: 2", "Frames: 99999"),
}


@pytest.mark.parametrize("text", HUGE.values(), ids=HUGE)
def test_huge_files_cost_little(text):
    tracemalloc.start()
    with pytest.raises(InputError):
        parse_bvh(text.encode(), "huge.bvh")
    assert tracemalloc.get_traced_memory()[1] < 60e6
    tracemalloc.stop()
