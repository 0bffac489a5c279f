"""One participant on one network interface, its readers and writers, and a thread that hears the newest sample."""

import os
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any
from xml.sax.saxutils import quoteattr

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from core import robot_time as time
from core.errors import InputError
from hal import realtime
from hal.contract.types import DeviceError

LOOPBACK = "lo"
DOMAINS = range(233)
POLL_S = 0.05
TOPICS_MAX = 1000
END_S = 1.0
_INTERFACE = re.compile(r"[A-Za-z0-9_.:-]{1,15}")


def configuration(interface: str) -> str:
    """CycloneDDS's configuration for one interface by name; loopback, which cannot multicast, finds peers by address.

    Raises InputError on a name that no interface can have.
    """
    if not _INTERFACE.fullmatch(interface):
        raise InputError("no name of a network interface", where="dds", got=repr(interface), expected="such as eth0")
    if interface == LOOPBACK:
        general = '<AllowMulticast>false</AllowMulticast><Interfaces><NetworkInterface name="lo"/></Interfaces>'
        discovery = (
            "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>9</MaxAutoParticipantIndex>"
            '<Peers><Peer address="127.0.0.1"/></Peers></Discovery>'
        )
    else:
        name = quoteattr(interface)
        general = f'<Interfaces><NetworkInterface name={name} priority="default" multicast="default"/></Interfaces>'
        discovery = ""
    return f'<CycloneDDS><Domain Id="any"><General>{general}</General>{discovery}</Domain></CycloneDDS>'


class DdsLink:
    """A participant of a domain. Raises InputError on an impossible domain, DeviceError where it cannot be joined."""

    def __init__(self, domain: int, interface: str) -> None:
        if domain not in DOMAINS:
            raise InputError("domain", where="dds", got=domain, expected=f"0 to {DOMAINS[-1]}")
        xml = configuration(interface)
        self.name = f"domain {domain} on {interface}"
        try:
            with _punctual():
                self._domain = Domain(domain, xml)
                self._participant = DomainParticipant(domain)
        except DDSException as error:
            hint = "is the interface up, and no other participant of the domain in this process?"
            raise DeviceError(f"dds: cannot join {self.name}: {error.msg.strip()}; {hint}") from error
        self._topics: dict[str, Topic] = {}

    def reader(self, topic: str, kind: Any, *, others_only: bool = False) -> DataReader:
        """A reader that keeps the newest sample. others_only: not what this participant writes."""
        ignored = Policy.IgnoreLocal.Participant if others_only else Policy.IgnoreLocal.Nothing
        return DataReader(self._participant, self._topic(topic, kind), qos=Qos(ignored))

    def queue_reader(self, topic: str, kind: Any, depth: int) -> DataReader:
        """A reliable reader that keeps the newest `depth` samples."""
        qos = Qos(Policy.Reliability.Reliable(max_blocking_time=0), Policy.History.KeepLast(depth))
        return DataReader(self._participant, self._topic(topic, kind), qos=qos)

    def published_topics(self) -> set[str]:
        """The names of the topics that anybody in the domain publishes, as far as they have been discovered."""
        found = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        return {sample.topic_name for sample in found.take(TOPICS_MAX)}

    def writer(self, topic: str, kind: Any) -> DataWriter:
        """A writer."""
        return DataWriter(self._participant, self._topic(topic, kind))

    def inbox(self, reader: DataReader, hear: Callable[[Any, float], None], name: str) -> "Inbox":
        """A thread that calls `hear(sample, monotonic time of arrival)` with what a reader gets."""
        return Inbox(self._participant, reader, hear, name)

    def _topic(self, name: str, kind: Any) -> Topic:
        if name not in self._topics:
            self._topics[name] = Topic(self._participant, name, kind)
        return self._topics[name]


@contextmanager
def _punctual() -> Iterator[None]:
    """Threads that are started within, CycloneDDS's own, run at the wire's priority where that is permitted."""
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(realtime.WIRE_PRIORITY))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, priority)


class Inbox:
    """Hears what a reader gets, as soon as it arrives."""

    def __init__(
        self, participant: DomainParticipant, reader: DataReader, hear: Callable[[Any, float], None], name: str
    ) -> None:
        self.failure: Exception | None = None
        self._reader, self._hear = reader, hear
        self._fresh = ReadCondition(reader, ViewState.Any | InstanceState.Alive | SampleState.NotRead)
        self._waiting = WaitSet(participant)
        self._waiting.attach(self._fresh)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End. May be repeated."""
        self._stop.set()
        if self._thread is not threading.current_thread():
            self._thread.join(END_S)

    def _run(self) -> None:
        realtime.schedule(realtime.WIRE_PRIORITY)
        try:
            while not self._stop.is_set():
                if not self._waiting.wait(int(1e9 * POLL_S)):
                    continue
                now_s = time.monotonic()
                for sample in self._reader.take(condition=self._fresh):
                    self._hear(sample, now_s)
        except Exception as error:
            self.failure = error
