"""Parser of BVH files: the hierarchy of joints and the values of their channels. What they mean is said elsewhere."""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from core.errors import InputError
from motion.frames import MAX_FRAMES, check_frames

MAX_JOINTS = 500
MAX_BYTES = 64 * 2**20
MAX_LINES = MAX_FRAMES + 10_000
MAX_LINE = 100_000  # characters
END_SITE = "/end"  # the end site of a joint is a joint of this name behind the joint's
_CHANNELS = {f"{axis}{kind}" for axis in "xyz" for kind in ("position", "rotation")}


@dataclass
class BvhJoint:
    """A joint or end site: `parent` -1 for the root; offset (3,) in the file's unit; channels in their order, as
    xposition ... zrotation; `first` is the column of its first channel."""

    name: str
    parent: int
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    channels: tuple[str, ...] = ()
    first: int = 0


@dataclass(frozen=True, eq=False)
class Bvh:
    """A BVH file: joints, each after its parent; values (N,C), positions in the file's unit and rotations in degrees.

    `frame_time_text` is the frame time as written, in seconds: its digits tell how exact it is.
    """

    joints: tuple[BvhJoint, ...]
    values: np.ndarray
    frame_time_text: str


@dataclass
class _Lines:
    """The file's words, line by line."""

    where: str
    lines: list[str]
    number: int = 0
    words: deque[str] = field(default_factory=deque)

    def error(self, what: str, got: object, expected: str) -> InputError:
        return InputError(what, where=f"{self.where}: line {max(self.number, 1)}", got=got, expected=expected)

    def next_line(self, expected: str) -> list[str]:
        """The words of the next line that is not empty, if no word is left over."""
        if self.words:
            raise self.error("unexpected word", repr(self.words[0][:40]), expected)
        while self.number < len(self.lines):
            line = self.lines[self.number]
            self.number += 1
            if len(line) > MAX_LINE:
                raise self.error("line too long", f"{len(line)} characters", f"at most {MAX_LINE}")
            if words := line.split():
                return words
        raise self.error("the file ends too early", "nothing", expected)

    def word(self, expected: str) -> str:
        """The next word, on whatever line it is."""
        if not self.words:
            self.words = deque(self.next_line(expected))
        return self.words.popleft()

    def expect(self, expected: str) -> None:
        """Take the next word, which must be `expected`."""
        word = self.word(expected)
        if word.lower() != expected.lower():
            raise self.error("unexpected word", repr(word[:40]), expected)

    def number_here(self, expected: str) -> float:
        """The next word as a finite number."""
        return self.finite(self.word(expected), expected)

    def finite(self, word: str, expected: str) -> float:
        """`word` as a finite number."""
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or "_" in word:
            raise self.error("not a number", repr(word[:40]), expected)
        return value


def parse_bvh(content: bytes, where: str) -> Bvh:
    """The BVH file given as bytes. Raises InputError naming `where` and the line."""
    line_count = content.count(b"\n")
    if len(content) > MAX_BYTES or line_count > MAX_LINES:
        got = f"{len(content)} bytes, {line_count} lines"
        raise InputError("file too large", where=where, got=got, expected=f"at most {MAX_BYTES}, {MAX_LINES}")
    try:
        text = content.decode("utf-8-sig").replace("{", " { ").replace("}", " } ")
    except UnicodeDecodeError as error:
        raise InputError("is not text", where=where, expected="a BVH file") from error
    lines = _Lines(where, text.split("\n"))
    joints = _hierarchy(lines)
    columns = sum(len(joint.channels) for joint in joints)
    lines.expect("Frames:")
    count = lines.number_here("the number of frames")
    if not count.is_integer() or abs(count) > MAX_BYTES:
        raise lines.error("impossible number", f"{count:g}", "the number of frames")
    for word in ("Frame", "Time:"):
        lines.expect(word)
    frame_time = lines.word("the frame time")
    lines.finite(frame_time, "the frame time in seconds")
    return Bvh(joints, _values(lines, int(count), columns), frame_time)


def _hierarchy(lines: _Lines) -> tuple[BvhJoint, ...]:
    """The joints, up to and with the word MOTION. Open braces are counted, not nested: depth costs nothing."""
    lines.expect("HIERARCHY")
    lines.expect("ROOT")
    joints = [BvhJoint(_name(lines), -1)]
    open_joints = [0]
    columns = 0
    while open_joints:
        word = lines.word("OFFSET, CHANNELS, JOINT, End or }").lower()
        joint = joints[open_joints[-1]]
        if word == "}":
            open_joints.pop()
        elif word == "offset":
            joint.offset = tuple(lines.number_here("three offsets") for _ in range(3))  # type: ignore[assignment]
        elif word == "channels" and not joint.channels and not joint.name.endswith(END_SITE):
            joint.channels, joint.first = _channels(lines), columns
            columns += len(joint.channels)
        elif word in ("joint", "end") and not joint.name.endswith(END_SITE):
            name = _name(lines) if word == "joint" else _end_name(lines, joint.name)
            _add(joints, BvhJoint(name, open_joints[-1]), lines)
            open_joints.append(len(joints) - 1)
        else:
            raise lines.error("unexpected word", repr(word[:40]), "OFFSET, CHANNELS once, JOINT, End Site or }")
    lines.expect("MOTION")
    return tuple(joints)


def _add(joints: list[BvhJoint], joint: BvhJoint, lines: _Lines) -> None:
    if any(other.name == joint.name for other in joints):
        raise lines.error("joint appears twice", joint.name[:40], "each name once")
    if len(joints) >= MAX_JOINTS:
        raise lines.error("too many joints", len(joints) + 1, f"at most {MAX_JOINTS}")
    joints.append(joint)


def _name(lines: _Lines) -> str:
    """The words up to the brace: some programs write names with spaces."""
    words = [lines.word("the name of a joint")]
    while (word := lines.word("{")) != "{":
        words.append(word)
        if len(words) > 10:
            raise lines.error("unexpected word", repr(word[:40]), "{")
    return " ".join(words)


def _end_name(lines: _Lines, parent: str) -> str:
    lines.expect("Site")
    while lines.word("{") != "{":  # some programs name their end sites
        pass
    return f"{parent}{END_SITE}"


def _channels(lines: _Lines) -> tuple[str, ...]:
    count = lines.number_here("the number of channels")
    if count not in range(len(_CHANNELS) + 1):
        raise lines.error("wrong number of channels", f"{count:g}", f"0 to {len(_CHANNELS)}")
    names = tuple(lines.word("a channel").lower() for _ in range(int(count)))
    for name in names:
        if name not in _CHANNELS or names.count(name) > 1:
            raise lines.error("wrong channel", repr(name[:40]), "Xposition ... Zrotation, each once")
    return names


def _values(lines: _Lines, count: int, columns: int) -> np.ndarray:
    """The frames (N,C), one a line; nothing is allocated that the file does not hold."""
    check_frames(count, f"{lines.where}: line {lines.number}: Frames")
    if columns < 3:
        raise lines.error("no channels", columns, "three or more channels")
    left = sum(1 for line in lines.lines[lines.number :] if line.strip())
    if left != count:
        raise InputError(
            "number of frames differs", where=lines.where, got=f"{left} lines of values", expected=f"{count} as stated"
        )
    values = np.empty((count, columns))
    for frame in range(count):
        words = lines.next_line("a frame")
        if len(words) != columns:
            raise lines.error("wrong number of values", len(words), f"{columns}, one a channel")
        values[frame] = [lines.finite(word, "a number") for word in words]
    return values
