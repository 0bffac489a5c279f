"""An MCAP file that is whole up to its last flush, however the writing ends."""

import json
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, cast

from mcap.writer import Writer

from core.errors import InputError
from deploy.record.channels import CHANNELS, Message, encoded


class McapFile:
    """A new file of this time's name in a folder, with every channel.

    What has been flushed outlives the process: the kernel has it. The metadata "run" hold the joints' names, the wall
    clock beside the monotonic one at the beginning, and what `about` says. After an OSError the file ends with its
    last flush, and only `close` may follow. Raises InputError where no file can be made.
    """

    def __init__(self, folder: Path, joint_names: Sequence[str], about: Mapping[str, str]) -> None:
        clocks = {"began_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())}
        clocks |= {"began_unix_s": f"{time.time():.6f}", "began_monotonic_s": f"{time.monotonic():.6f}"}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self.path = _unused(folder)
            self._stream = _WholeWrites(self.path)
            self._writer = Writer(cast("IO[Any]", self._stream))
            self._writer.start(profile="", library="kata")
            self._channels = {topic: self._register(topic) for topic in CHANNELS}
            self._writer.add_metadata("run", {**clocks, **about, "joint_names": json.dumps(joint_names)})
        except OSError as error:
            raise InputError(f"no log can be written here ({error.strerror})", where=folder) from error

    def add(self, message: Message) -> None:
        """One more message. Raises OSError where it cannot be written."""
        topic, time_ns, fields = message
        self._writer.add_message(self._channels[topic], log_time=time_ns, publish_time=time_ns, data=encoded(fields))

    def flush(self) -> None:
        """Hand everything to the kernel. Raises OSError where it cannot be written."""
        self._writer.flush()

    def sync(self) -> None:
        """Wait until what was flushed is on the disk. Raises OSError."""
        self._stream.sync()

    def finish(self) -> None:
        """Write the index, by which readers find their way faster. Raises OSError where it cannot be written."""
        self._writer.finish()
        self._stream.flush()

    def close(self) -> None:
        """Cut off what is not whole, and let go of the file."""
        self._stream.close()

    def _register(self, topic: str) -> int:
        data = json.dumps({"type": "object", "properties": CHANNELS[topic]}).encode()
        name = f"kata{topic.replace('/', '.')}"
        schema = self._writer.register_schema(name=name, encoding="jsonschema", data=data)
        return self._writer.register_channel(topic=topic, message_encoding="json", schema_id=schema)


class _WholeWrites:
    """What the writer needs of a file. Nothing waits in this process, so nothing is lost with it."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        self._position = self._whole = 0

    def write(self, data: bytes) -> None:
        """All of it; a disk that is full takes a part and refuses the rest."""
        left = memoryview(data)
        while left:
            written = os.write(self._fd, left)
            self._position += written
            left = left[written:]

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Called where a record has ended."""
        self._whole = self._position

    def sync(self) -> None:
        os.fdatasync(self._fd)

    def close(self) -> None:
        try:
            os.ftruncate(self._fd, self._whole)
        finally:
            os.close(self._fd)


def _unused(folder: Path) -> Path:
    path, attempt = folder / time.strftime("run-%Y%m%d-%H%M%S.mcap"), 1
    while path.exists():
        attempt += 1
        path = folder / time.strftime(f"run-%Y%m%d-%H%M%S-{attempt}.mcap")
    return path
